// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* Linear combinations of rows, out[r] += sum_k coefficient(r, k) in[k], held in registers. */
#ifndef GTMR_COMBINE_H
#define GTMR_COMBINE_H

#include "vec.h"

#if defined(__GNUC__)
#define UNROLLED static inline __attribute__((always_inline))
#else
#define UNROLLED static inline
#endif

enum { TILE_ROWS = 4, TILE_VECS = 3 };

/* Where the coefficients are: that of row r and term k at at[r * row + k * term]. */
typedef struct {
    const double *at;
    ptrdiff_t row;
    ptrdiff_t term;
} coefficients;

UNROLLED void combine_tile(int rows, int vecs, int terms, coefficients by, const double *in,
                           ptrdiff_t ld_in, double *out, ptrdiff_t ld_out)
{
    vec total[TILE_ROWS][TILE_VECS];
    for (int r = 0; r < rows; ++r) {
        for (int c = 0; c < vecs; ++c) {
            total[r][c] = load(out + r * ld_out + c * VEC);
        }
    }
    for (int k = 0; k < terms; ++k) {
        vec term[TILE_VECS];
        for (int c = 0; c < vecs; ++c) {
            term[c] = load(in + k * ld_in + c * VEC);
        }
        for (int r = 0; r < rows; ++r) {
            const double factor = by.at[r * by.row + k * by.term];
            for (int c = 0; c < vecs; ++c) {
                total[r][c] += factor * term[c];
            }
        }
    }
    for (int r = 0; r < rows; ++r) {
        for (int c = 0; c < vecs; ++c) {
            store(out + r * ld_out + c * VEC, total[r][c]);
        }
    }
}

UNROLLED void combine_rows(int rows, int columns, int terms, coefficients by, const double *in,
                           ptrdiff_t ld_in, double *out, ptrdiff_t ld_out)
{
    int c = 0;
    for (; c + TILE_VECS * VEC <= columns; c += TILE_VECS * VEC) {
        combine_tile(rows, TILE_VECS, terms, by, in + c, ld_in, out + c, ld_out);
    }
    for (; c < columns; c += VEC) {
        combine_tile(rows, 1, terms, by, in + c, ld_in, out + c, ld_out);
    }
}

/* columns: padded to whole registers. */
static inline void combine(int rows, int columns, int terms, coefficients by, const double *in,
                           ptrdiff_t ld_in, double *out, ptrdiff_t ld_out)
{
    int r = 0;
    for (; r + TILE_ROWS <= rows; r += TILE_ROWS) {
        combine_rows(TILE_ROWS, columns, terms, by, in, ld_in, out, ld_out);
        by.at += TILE_ROWS * by.row;
        out += TILE_ROWS * ld_out;
    }
    switch (rows - r) {
    case 3:
        combine_rows(3, columns, terms, by, in, ld_in, out, ld_out);
        break;
    case 2:
        combine_rows(2, columns, terms, by, in, ld_in, out, ld_out);
        break;
    case 1:
        combine_rows(1, columns, terms, by, in, ld_in, out, ld_out);
        break;
    default:
        break;
    }
}

/* length: padded to whole registers. */
static inline double dot(const double *a, const double *b, int length)
{
    vec even = vec_of(0.0), odd = vec_of(0.0);
    int i = 0;
    for (; i + 2 * VEC <= length; i += 2 * VEC) {
        even += load(a + i) * load(b + i);
        odd += load(a + i + VEC) * load(b + i + VEC);
    }
    if (i < length) {
        even += load(a + i) * load(b + i);
    }
    return sum(even + odd);
}

/* Products of rows with one vector: each alone would wait for its own sums. */
UNROLLED void dot_tile(int rows, const double *const *row, const double *with, int length,
                       double *out)
{
    vec total[TILE_ROWS];
    for (int r = 0; r < rows; ++r) {
        total[r] = vec_of(0.0);
    }
    for (int i = 0; i < length; i += VEC) {
        const vec term = load(with + i);
        for (int r = 0; r < rows; ++r) {
            total[r] += load(row[r] + i) * term;
        }
    }
    for (int r = 0; r < rows; ++r) {
        out[r] = sum(total[r]);
    }
}

/* out += sum_r factor[r] row[r]. */
UNROLLED void add_tile(int rows, const double *factor, const double *const *row, int length,
                       double *out)
{
    for (int i = 0; i < length; i += VEC) {
        vec total = load(out + i);
        for (int r = 0; r < rows; ++r) {
            total += factor[r] * load(row[r] + i);
        }
        store(out + i, total);
    }
}

static inline void add_scaled(double *out, double factor, const double *in, int length)
{
    for (int i = 0; i < length; i += VEC) {
        store(out + i, load(out + i) + factor * load(in + i));
    }
}

#endif
