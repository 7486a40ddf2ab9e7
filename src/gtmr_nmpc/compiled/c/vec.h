// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* Rows of doubles: one register at a time where the compiler has vectors, one number where not. */
#ifndef GTMR_VEC_H
#define GTMR_VEC_H

#include <math.h>
#include <stddef.h>

#if defined(__GNUC__)
#if defined(__AVX512F__)
#define VEC 8
#elif defined(__AVX__)
#define VEC 4
#else
#define VEC 2
#endif
typedef double vec __attribute__((vector_size(8 * VEC), may_alias));
/* As it stands in a row, which may start anywhere. For memory alone: a variable of this type may
 * leave the stack less aligned than GCC 12 takes it to be. */
typedef double vec_in_row __attribute__((vector_size(8 * VEC), aligned(8), may_alias));
/* Of what begins at a register's alignment, so that its rows do not straddle lines of the cache. */
#define ALIGNED __attribute__((aligned(8 * VEC)))
#else
#define VEC 1
typedef double vec, vec_in_row;
#define ALIGNED
#endif

/* Length of a row of n doubles, filled up to whole registers. */
#define PADDED(n) (((n) + VEC - 1) / VEC * VEC)

static inline vec vec_of(double a)
{
    return (vec){0} + a;
}

static inline vec load(const double *row)
{
    return *(const vec_in_row *)row;
}

static inline void store(double *row, vec a)
{
    *(vec_in_row *)row = a;
}

/* Halves are added to each other, which is the shortest chain of additions. */
static inline double sum(vec a)
{
#if VEC == 1
    return a;
#else
    typedef double pair __attribute__((vector_size(16), may_alias));
    const pair *pairs = (const pair *)&a;
    pair total = pairs[0];
#if VEC == 8
    typedef double four __attribute__((vector_size(32), may_alias));
    const four *fours = (const four *)&a;
    const four both = fours[0] + fours[1];
    pairs = (const pair *)&both;
    total = pairs[0] + pairs[1];
#elif VEC == 4
    total += pairs[1];
#endif
    return total[0] + total[1];
#endif
}

/* Nearest integer, for |a| < 2^51: adding 1.5 2^52 leaves no bits behind the point. */
static inline vec vec_round(vec a)
{
    const vec shift = vec_of(6755399441055744.0);
    return (a + shift) - shift;
}

/*
 * sin(a + quarter pi/2) to an ulp or so, for |a| < 1e5: the same work in every lane, no branches.
 * Reduction after Cody and Waite, polynomials of Cephes.
 */
static inline vec vec_sin_shifted(vec a, double quarter)
{
    const vec n = vec_round(a * 0.63661977236758134308);
    const vec r =
        ((a - n * 1.57079625129699707031) - n * 7.54978941586159635335e-8) -
        n * 5.39030252995776476554e-15;
    const vec z = r * r;
    const vec s =
        r + r * z *
                (((((1.58962301576546568060e-10 * z - 2.50507477628578072866e-8) * z +
                    2.75573136213857245213e-6) *
                       z -
                   1.98412698295895385996e-4) *
                      z +
                  8.33333333332211858878e-3) *
                     z -
                 1.66666666666666307295e-1);
    const vec c =
        1.0 - 0.5 * z +
        z * z *
            (((((-1.13585365213876817300e-11 * z + 2.08757008419747316778e-9) * z -
                2.75573141792967388112e-7) *
                   z +
               2.48015872888517045348e-5) *
                  z -
              1.38888888888730564116e-3) *
                 z +
             4.16666666666665929218e-2);
    const vec m = n + quarter;
    const vec half = vec_round(m * 0.5 - 0.25);
    const vec odd = m - 2.0 * half;
    const vec sign = 1.0 - 2.0 * (half - 2.0 * vec_round(half * 0.5 - 0.25));
    return sign * (s * (1.0 - odd) + c * odd);
}

static inline vec vec_sin(vec a)
{
    return vec_sin_shifted(a, 0.0);
}

static inline vec vec_cos(vec a)
{
    return vec_sin_shifted(a, 1.0);
}

#endif
