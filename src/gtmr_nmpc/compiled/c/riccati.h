// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* Parts of a stage of the Riccati recursion; inline, as whole stages are one run of registers. */
#ifndef GTMR_RICCATI_H
#define GTMR_RICCATI_H

#include <string.h>

#include "combine.h"
#include "workspace.h"

/* Where the rows of omega begin. */
enum { OMEGA_COLUMNS = OMEGA / VEC * VEC };

/* Rows of the inputs, beside each of which is one of the identity. */
typedef double input_rows[N_U][LD_XU + LD_U];

/* Hessian of stage cost plus cost to go with respect to [x u], and what leads to it. */
typedef struct {
    /* P [A B] by the body's part of [A B] alone, in the order of the jacobian, with the weighted
     * rows of the acceleration; then its rows of the rotors. */
    double W[N_H + N_U][LD_XU];
    /* What the rows of the body, of the rotors and of the inputs begin with. */
    double weights[BODY][LD_X];
    double of_rotors[N_U][LD_XU];
    double of_inputs[N_U][LD_XU];
    input_rows of_input;
    double identity[N_U][LD_U]; /* what stands beside those */
} hessian;

static void at_the_end(const gtmr_controller *c, value_function *to)
{
    memset(to, 0, sizeof *to);
    for (int j = 0; j < 3; ++j) {
        to->P[j][j] = 2.0 * c->parameters.terminal_weights[j];
        to->p[j] = 2.0 * c->cost_gradient[STAGES][j];
    }
}

static void weigh(const gtmr_controller *c, hessian *H)
{
    const double *w = c->parameters.stage_weights;
    memset(H, 0, sizeof *H);
    for (int j = 0; j < 3; ++j) {
        H->weights[j][j] = 2.0 * w[j];
        H->weights[3 + j][3 + j] = 2.0 * w[9 + j];
        H->weights[6 + j][6 + j] = 2.0 * w[3 + j];
        H->weights[9 + j][9 + j] = 2.0 * w[12 + j];
    }
    for (int r = 0; r < N_U; ++r) {
        H->identity[r][r] = 1.0;
    }
}

UNROLLED void multiply(int rows, const double *P, const interval *at, double *W)
{
    const double none[LD_XU] = {0.0}, *left = at->jacobian[0], *right = left + OMEGA_COLUMNS;
    const beginning zero = {none, 0, 1.0};
    const coefficients by = {P, LD_X, 1};
    combine_from(rows, OMEGA_COLUMNS, OMEGA, by, left, LD_XU, zero, W, LD_XU);
    combine_from(rows, LD_XU - OMEGA_COLUMNS, BODY, by, right, LD_XU, zero, W + OMEGA_COLUMNS,
                 LD_XU);
}

/*
 * Rotor speeds integrate the inputs: their part of [A B] is [0 I T_s I], whose products are moved
 * to their places. Done before the rows of the body, so that it is out of the way when needed.
 */
static void begin_rotors(const gtmr_controller *c, const value_function *next, hessian *H)
{
    double(*W)[LD_XU] = H->W + N_H;
    for (int i = 0; i < N_U; ++i) {
        for (int j = 0; j < LD_XU; j += VEC) {
            const vec row = load(W[i] + j);
            store(H->of_rotors[i] + j, row);
            store(H->of_inputs[i] + j, PERIOD_S * row);
        }
    }
    for (int i = 0; i < N_U; ++i) {
        for (int j = 0; j < N_U; ++j) {
            const double P = next->P[BODY + i][BODY + j];
            const double moved = W[j][N_X + i] + PERIOD_S * P;
            H->of_rotors[i][BODY + j] += W[j][BODY + i] + P;
            H->of_inputs[i][BODY + j] += moved;
            H->of_inputs[i][N_X + j] += PERIOD_S * moved;
        }
        H->of_inputs[i][N_X + i] += 2.0 * c->parameters.input_weight;
    }
}

static void carry_back(const gtmr_controller *c, const interval *at, const value_function *next,
                       hessian *H)
{
    multiply(N_U, next->P[BODY], at, H->W[N_H]);
    begin_rotors(c, next, H);
    multiply(BODY, next->P[0], at, H->W[0]);
    for (int i = 0; i < 3; ++i) {
        const double weight = 2.0 * c->parameters.stage_weights[6 + i];
        for (int j = 0; j < LD_XU; j += VEC) {
            store(H->W[BODY + i] + j, weight * load(at->jacobian[BODY + i] + j));
        }
    }
}

static void begin_inputs(const interval *at, hessian *H)
{
    const coefficients B = {at->jacobian[0] + N_X, 1, LD_XU};
    const beginning from = {H->of_inputs[0], LD_XU, 1.0};
    combine_from(N_U, LD_XU, BODY, B, H->W[0], LD_XU, from, H->of_input[0], LD_XU + LD_U);
    for (int r = 0; r < N_U; ++r) {
        for (int j = 0; j < LD_U; j += VEC) {
            store(H->of_input[r] + LD_XU + j, load(H->identity[r] + j));
        }
    }
}

/* Rows of the states, up to the diagonal. */
static void state_rows(const interval *at, const hessian *H, double P[N_X][LD_X])
{
    const double *W = H->W[0];
    const coefficients A = {at->jacobian[0], 1, LD_XU};
    const coefficients acceleration = {at->jacobian[BODY], 1, LD_XU};
    const beginning weights = {H->weights[0], LD_X, 1.0}, half = {P[0], LD_X, 1.0};
    const beginning rotors = {H->of_rotors[0] - BODY * LD_XU, LD_XU, 1.0};
    /* Positions go through the dynamics unchanged: their rows stand already. */
    for (int r = 0; r < ETA; ++r) {
        for (int j = 0; j < PADDED(ETA); j += VEC) {
            store(P[r] + j, load(H->weights[r] + j) + load(H->W[r] + j));
        }
    }
    combine_lower(ETA, OMEGA, OMEGA, A, W, LD_XU, weights, P[0], LD_X);
    combine_lower(ETA, OMEGA, 3, acceleration, H->W[BODY], LD_XU, half, P[0], LD_X);
    combine_lower(OMEGA, BODY, BODY, A, W, LD_XU, weights, P[0], LD_X);
    combine_lower(BODY, N_X, N_H, A, W, LD_XU, rotors, P[0], LD_X);
}

/* Gradient of stage cost plus cost to go with respect to [x u]. */
static void gradient(const gtmr_controller *c, int stage, const value_function *next, double *g)
{
    const interval *at = &c->intervals[stage];
    double y[LD_X];
    memcpy(y, next->p, sizeof y);
    const coefficients defect = {at->defect, 0, 1};
    combine(1, PADDED(BODY), N_X, defect, next->P[0], LD_X, y, LD_X);
    for (int j = 0; j < N_U; ++j) {
        y[BODY + j] = next->p[BODY + j] + dot(next->P[BODY + j], at->defect, LD_X);
    }
    const coefficients costate = {y, 0, 1};
    const beginning cost = {c->cost_gradient[stage], 0, 2.0};
    combine_from(1, LD_XU, BODY, costate, at->jacobian[0], LD_XU, cost, g, LD_XU);
    for (int j = 0; j < N_U; ++j) {
        const double u = c->u[stage][j];
        g[BODY + j] += y[BODY + j];
        g[N_X + j] += 2.0 * c->parameters.input_weight * u + PERIOD_S * y[BODY + j];
    }
}

/*
 * Cholesky factorisation of the inputs' part of H, row by row, with all that is right of it: H
 * becomes [Z L' C], C = L^-1, and g becomes z.
 */
static void eliminate(input_rows H, double *g)
{
    for (int j = 0; j < N_U; ++j) {
        /* Square roots wait for nothing that the next row needs. */
        const double inverse = 1.0 / H[j][N_X + j], scale = sqrt(inverse);
        for (int i = j + 1; i < N_U; ++i) {
            const double by = -inverse * H[j][N_X + i];
            add_scaled(H[i], by, H[j], LD_XU + LD_U);
            g[i] += by * g[j];
        }
        for (int k = 0; k < LD_XU + LD_U; k += VEC) {
            store(H[j] + k, scale * load(H[j] + k));
        }
        g[j] *= scale;
    }
}

/* What is kept of the elimination. */
static void keep_law(const input_rows H, const double *g, law *at)
{
    for (int r = 0; r < N_U; ++r) {
        memcpy(at->Z[r], H[r], N_X * sizeof(double));
        memcpy(at->whitening[r], H[r] + LD_XU, sizeof at->whitening[r]);
    }
    memcpy(at->z, g, N_U * sizeof(double));
}

/* Take away what the inputs save: P - Z' Z, p - Z' z. */
static void reduce(const law *at, const double *g, value_function *to)
{
    const coefficients Z = {at->Z[0], 1, LD_X}, z = {at->z, 0, 1};
    const beginning before = {to->P[0], LD_X, 1.0};
    ALIGNED double minus_Z[N_U][LD_X];
    for (int i = 0; i < N_U; ++i) {
        for (int j = 0; j < LD_X; j += VEC) {
            store(minus_Z[i] + j, -load(at->Z[i] + j));
        }
    }
    combine_lower(0, N_X, N_U, Z, minus_Z[0], LD_X, before, to->P[0], LD_X);
    memcpy(to->p, g, sizeof to->p);
    combine(1, LD_X, N_U, z, minus_Z[0], LD_X, to->p, LD_X);
}

static void mirror_block(value_function *to, int first, int last)
{
    UNROLL for (int block = 0; block < PADDED(N_X); block += VEC)
    {
        const int start = block > first ? block : first, behind = block + VEC;
        const int end = behind < last ? behind : last;
        for (int r = start; r < end; ++r) {
            for (int k = behind; k < last; ++k) {
                to->P[r][k] = to->P[k][r];
            }
        }
    }
}

static void mirror(value_function *to)
{
    mirror_block(to, 0, BODY);
    mirror_block(to, BODY, N_X);
}

/* Keep a cost to go; by registers, so that it stays local to whoever calls. */
UNROLLED void copy_value(const value_function *from, value_function *to)
{
    for (int r = 0; r < N_X; ++r) {
        for (int j = 0; j < LD_X; j += VEC) {
            store(to->P[r] + j, load(from->P[r] + j));
        }
    }
    for (int j = 0; j < LD_X; j += VEC) {
        store(to->p + j, load(from->p + j));
    }
}

#endif
