// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* Linear combinations of rows, held in registers. */
#ifndef GTMR_COMBINE_H
#define GTMR_COMBINE_H

#include "vec.h"

#if defined(__GNUC__)
#define UNROLLED static inline __attribute__((always_inline))
#define UNROLL _Pragma("GCC unroll 16")
/* Of what is known when compiling: its indices become constants. */
#define UNROLL_ALL _Pragma("GCC unroll 1024")
#else
#define UNROLL
#define UNROLL_ALL
#define UNROLLED static inline
#endif

enum { TILE_ROWS = 4, TILE_VECS = 3, MOST_ROWS = 8 };

/* Where the coefficients are: that of row r and term k at at[r * row + k * term]. */
typedef struct {
    const double *at;
    ptrdiff_t row;
    ptrdiff_t term;
} coefficients;

/* What the sums begin with: scale * at[r * ld + c]. */
typedef struct {
    const double *at;
    ptrdiff_t ld;
    double scale;
} beginning;

/* One row alone, of which each sum would wait for itself: its even and its odd terms. */
UNROLLED void combine_one(int vecs, int terms, coefficients by, const double *in, ptrdiff_t ld_in,
                          beginning from, double *out)
{
    vec even[TILE_VECS], odd[TILE_VECS];
    for (int c = 0; c < vecs; ++c) {
        even[c] = from.scale * load(from.at + c * VEC);
        odd[c] = vec_of(0.0);
    }
    for (int k = 0; k < terms; k += 2) {
        for (int c = 0; c < vecs; ++c) {
            even[c] += by.at[k * by.term] * load(in + k * ld_in + c * VEC);
            if (k + 1 < terms) {
                odd[c] += by.at[(k + 1) * by.term] * load(in + (k + 1) * ld_in + c * VEC);
            }
        }
    }
    for (int c = 0; c < vecs; ++c) {
        store(out + c * VEC, even[c] + odd[c]);
    }
}

UNROLLED void combine_tile(int rows, int vecs, int terms, coefficients by, const double *in,
                           ptrdiff_t ld_in, beginning from, double *out, ptrdiff_t ld_out)
{
    vec total[MOST_ROWS][TILE_VECS];
    if (rows == 1) {
        combine_one(vecs, terms, by, in, ld_in, from, out);
        return;
    }
    for (int r = 0; r < rows; ++r) {
        for (int c = 0; c < vecs; ++c) {
            total[r][c] = from.scale * load(from.at + r * from.ld + c * VEC);
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

#define COMBINE_TILES(height)                                                                    \
    for (; r + (height) <= rows; r += (height)) {                                                \
        const coefficients those = {by.at + r * by.row, by.row, by.term};                        \
        const beginning there = {from.at + r * from.ld, from.ld, from.scale};                    \
        combine_tile(height, vecs, terms, those, in, ld_in, there, out + r * ld_out, ld_out);    \
    }

/* All rows of a few columns, in tiles of about as many sums as keep the processor busy. */
UNROLLED void combine_columns(int vecs, int rows, int terms, coefficients by, const double *in,
                              ptrdiff_t ld_in, beginning from, double *out, ptrdiff_t ld_out)
{
    int r = 0;
    if (vecs == 1) {
        COMBINE_TILES(8)
    }
    if (vecs == 2) {
        COMBINE_TILES(6)
    }
    COMBINE_TILES(4)
    COMBINE_TILES(2)
    COMBINE_TILES(1)
}

/* out[r] = scale * from[r] + sum_k coefficient(r, k) in[k]; columns: padded to registers. */
UNROLLED void combine_from(int rows, int columns, int terms, coefficients by, const double *in,
                           ptrdiff_t ld_in, beginning from, double *out, ptrdiff_t ld_out)
{
    int c = 0;
    for (; c + 3 * VEC <= columns; c += 3 * VEC) {
        const beginning there = {from.at + c, from.ld, from.scale};
        combine_columns(3, rows, terms, by, in + c, ld_in, there, out + c, ld_out);
    }
    const beginning there = {from.at + c, from.ld, from.scale};
    if (columns - c == 2 * VEC) {
        combine_columns(2, rows, terms, by, in + c, ld_in, there, out + c, ld_out);
    } else if (columns - c == VEC) {
        combine_columns(1, rows, terms, by, in + c, ld_in, there, out + c, ld_out);
    }
}

/* out[r] += sum_k coefficient(r, k) in[k]. */
static inline void combine(int rows, int columns, int terms, coefficients by, const double *in,
                           ptrdiff_t ld_in, double *out, ptrdiff_t ld_out)
{
    const beginning from = {out, ld_out, 1.0};
    combine_from(rows, columns, terms, by, in, ld_in, from, out, ld_out);
}

/* The same for rows first..last-1 of a lower triangle, by registers up to the diagonal; all of it
 * begins at row 0. */
UNROLLED void combine_lower(int first, int last, int terms, coefficients by, const double *in,
                            ptrdiff_t ld_in, beginning from, double *out, ptrdiff_t ld_out)
{
    UNROLL for (int block = 0; block < PADDED(last); block += VEC)
    {
        const int start = block > first ? block : first;
        const int end = block + VEC < last ? block + VEC : last;
        if (start < end) {
            const coefficients those = {by.at + start * by.row, by.row, by.term};
            const beginning there = {from.at + start * from.ld, from.ld, from.scale};
            combine_from(end - start, block + VEC, terms, those, in, ld_in, there,
                         out + start * ld_out, ld_out);
        }
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
