// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/*
 * The QP without its inequalities, solved by Riccati recursion.
 *
 * With u = K x + k + C' v at every stage its cost is |v|^2 / 2: v = 0 is its solution, and the
 * inequalities become rows in v.
 */
#include <string.h>

#include "combine.h"
#include "workspace.h"

/* Cost to go, x' P x / 2 + p' x. */
typedef struct {
    double P[N_X][LD_X];
    double p[LD_X];
} value_function;

static void at_the_end(const gtmr_controller *c, value_function *to)
{
    memset(to, 0, sizeof *to);
    for (int j = 0; j < 3; ++j) {
        to->P[j][j] = 2.0 * c->parameters.terminal_weights[j];
        to->p[j] = 2.0 * c->cost_gradient[STAGES][j];
    }
}

/* P [A B], and below it the weighted rows of the acceleration. */
static void carry_back(const gtmr_controller *c, const interval *at, const value_function *next,
                       double W[N_H + N_U][LD_XU])
{
    /* Rows are ordered as those of the jacobian; the rotor speeds come last. */
    for (int r = 0; r < N_X; ++r) {
        double *row = W[r < BODY ? r : r + 3];
        memset(row, 0, LD_XU * sizeof(double));
        for (int j = 0; j < N_U; ++j) {
            row[BODY + j] = next->P[r][BODY + j];
            row[N_X + j] = PERIOD_S * next->P[r][BODY + j];
        }
    }
    const coefficients body = {&next->P[0][0], LD_X, 1};
    combine(BODY, LD_XU, BODY, body, at->jacobian[0], LD_XU, W[0], LD_XU);
    const coefficients rotors = {&next->P[BODY][0], LD_X, 1};
    combine(N_U, LD_XU, BODY, rotors, at->jacobian[0], LD_XU, W[N_H], LD_XU);
    for (int i = 0; i < 3; ++i) {
        const double weight = 2.0 * c->parameters.stage_weights[6 + i];
        for (int j = 0; j < LD_XU; ++j) {
            W[BODY + i][j] = weight * at->jacobian[BODY + i][j];
        }
    }
}

/* Hessian of stage cost plus cost to go with respect to [x u]. */
static void hessian(const gtmr_controller *c, const interval *at, double W[N_H + N_U][LD_XU],
                    double H[N_XU][LD_XU])
{
    const double *w = c->parameters.stage_weights;
    memcpy(H[0], W[0], 3 * sizeof H[0]);
    memset(H[3], 0, (BODY - 3) * sizeof H[0]);
    memcpy(H[BODY], W[N_H], N_U * sizeof H[0]);
    for (int j = 0; j < N_U; ++j) {
        for (int i = 0; i < LD_XU; ++i) {
            H[N_X + j][i] = PERIOD_S * W[N_H + j][i];
        }
        H[N_X + j][N_X + j] += 2.0 * c->parameters.input_weight;
    }
    for (int j = 0; j < 3; ++j) {
        H[j][j] += 2.0 * w[j];
        H[3 + j][3 + j] += 2.0 * w[9 + j];
        H[6 + j][6 + j] += 2.0 * w[3 + j];
        H[9 + j][9 + j] += 2.0 * w[12 + j];
    }
    /* Positions go through the dynamics unchanged: their rows stand already. */
    const coefficients transposed = {&at->jacobian[0][3], 1, LD_XU};
    combine(N_XU - 3, LD_XU, N_H, transposed, W[0], LD_XU, H[3], LD_XU);
}

/* Gradient of stage cost plus cost to go with respect to [x u]. */
static void gradient(const gtmr_controller *c, int stage, const value_function *next, double *g)
{
    const interval *at = &c->intervals[stage];
    double y[LD_X];
    memcpy(y, next->p, sizeof y);
    const coefficients defect = {at->defect, 0, 1};
    combine(1, LD_X, N_X, defect, next->P[0], LD_X, y, LD_X);
    memset(g, 0, LD_XU * sizeof(double));
    for (int j = 0; j < N_X; ++j) {
        g[j] = 2.0 * c->cost_gradient[stage][j] + (j >= BODY ? y[j] : 0.0);
    }
    for (int j = 0; j < N_U; ++j) {
        g[N_X + j] = 2.0 * c->parameters.input_weight * c->u[stage][j] + PERIOD_S * y[BODY + j];
    }
    const coefficients costate = {y, 0, 1};
    combine(1, LD_XU, BODY, costate, at->jacobian[0], LD_XU, g, LD_XU);
}

/* C = L^-1 for the Cholesky factor L of the Hessian of u. */
static void whiten(double H[N_XU][LD_XU], double C[N_U][N_U])
{
    double L[N_U][N_U];
    for (int j = 0; j < N_U; ++j) {
        double diagonal = H[N_X + j][N_X + j];
        for (int k = 0; k < j; ++k) {
            diagonal -= L[j][k] * L[j][k];
        }
        C[j][j] = 1.0 / sqrt(diagonal);
        for (int i = j + 1; i < N_U; ++i) {
            double entry = H[N_X + i][N_X + j];
            for (int k = 0; k < j; ++k) {
                entry -= L[i][k] * L[j][k];
            }
            L[i][j] = entry * C[j][j];
        }
    }
    for (int j = 0; j < N_U; ++j) {
        for (int i = j + 1; i < N_U; ++i) {
            double entry = 0.0;
            for (int k = j; k < i; ++k) {
                entry -= L[i][k] * C[k][j];
            }
            C[i][j] = entry * C[i][i];
        }
    }
}

static void feedback_law(interval *at, double H[N_XU][LD_XU], const double *g,
                         value_function *to)
{
    double Z[N_U][LD_X] = {{0.0}}, z[N_U];
    whiten(H, at->whitening);
    const coefficients C = {at->whitening[0], N_U, 1};
    combine(N_U, LD_X, N_U, C, H[N_X], LD_XU, Z[0], LD_X);
    for (int i = 0; i < N_U; ++i) {
        z[i] = 0.0;
        for (int k = 0; k <= i; ++k) {
            z[i] += at->whitening[i][k] * g[N_X + k];
        }
    }
    double minus_Z[N_U][LD_X];
    for (int i = 0; i < N_U; ++i) {
        for (int j = 0; j < LD_X; ++j) {
            minus_Z[i][j] = -Z[i][j];
        }
    }
    memset(at->gain, 0, sizeof at->gain);
    const coefficients C_transposed = {at->whitening[0], 1, N_U};
    combine(N_U, LD_X, N_U, C_transposed, minus_Z[0], LD_X, at->gain[0], LD_X);
    for (int i = 0; i < N_U; ++i) {
        at->offset[i] = 0.0;
        for (int k = i; k < N_U; ++k) {
            at->offset[i] -= at->whitening[k][i] * z[k];
        }
    }
    for (int r = 0; r < N_X; ++r) {
        memcpy(to->P[r], H[r], sizeof to->P[r]);
    }
    memcpy(to->p, g, sizeof to->p);
    const coefficients Z_transposed = {Z[0], 1, LD_X};
    combine(N_X, LD_X, N_U, Z_transposed, minus_Z[0], LD_X, to->P[0], LD_X);
    const coefficients reduced = {z, 0, 1};
    combine(1, LD_X, N_U, reduced, minus_Z[0], LD_X, to->p, LD_X);
}

void gtmr_riccati_factorise(gtmr_controller *c)
{
    value_function to_go;
    double W[N_H + N_U][LD_XU], H[N_XU][LD_XU], g[LD_XU];
    at_the_end(c, &to_go);
    for (int i = STAGES - 1; i >= 0; --i) {
        carry_back(c, &c->intervals[i], &to_go, W);
        hessian(c, &c->intervals[i], W, H);
        gradient(c, i, &to_go, g);
        feedback_law(&c->intervals[i], H, g, &to_go);
    }
}

void gtmr_riccati_rollout(gtmr_controller *c, const double *dx0, const double *v)
{
    memset(c->step, 0, sizeof c->step);
    memcpy(c->step[0], dx0, N_X * sizeof(double));
    for (int i = 0; i < STAGES; ++i) {
        const interval *at = &c->intervals[i];
        double *now = c->step[i], *next = c->step[i + 1], du[N_U];
        for (int r = 0; r < N_U; ++r) {
            du[r] = at->offset[r] + dot(at->gain[r], now, LD_X);
            for (int k = r; v != NULL && k < N_U; ++k) {
                du[r] += at->whitening[k][r] * v[i * N_U + k];
            }
        }
        memcpy(now + N_X, du, sizeof du);
        for (int r = 0; r < BODY; ++r) {
            next[r] = at->defect[r] + dot(at->jacobian[r], now, LD_XU);
        }
        for (int r = 0; r < N_U; ++r) {
            next[BODY + r] = at->defect[BODY + r] + now[BODY + r] + PERIOD_S * du[r];
        }
    }
}
