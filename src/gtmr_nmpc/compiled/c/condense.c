// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* The inequalities of all stages as rows in v, in which the cost is |v|^2 / 2. */
#include <string.h>

#include "combine.h"
#include "workspace.h"

/* Response of a stage's state and input to v: body, rotor speeds, inputs. */
typedef double response[N_XU][LD_V];

static void input_rows(gtmr_controller *c, int stage, response of)
{
    const interval *at = &c->intervals[stage];
    const int before = stage * N_U, length = PADDED(before + N_U);
    for (int r = 0; r < N_U; ++r) {
        memset(of[N_X + r], 0, length * sizeof(double));
        for (int k = r; k < N_U; ++k) {
            of[N_X + r][before + k] = at->whitening[k][r];
        }
    }
    const coefficients K = {at->gain[0], LD_X, 1};
    combine(N_U, PADDED(before), N_X, K, of[0], LD_V, of[N_X], LD_V);
    for (int r = 0; r < N_U; ++r) {
        memcpy(c->rows[row_of(stage, r)], of[N_X + r], length * sizeof(double));
    }
}

static void speed_rows(gtmr_controller *c, int stage, response of)
{
    const int length = PADDED((stage + 1) * N_U);
    for (int r = 0; r < N_U; ++r) {
        add_scaled(of[BODY + r], PERIOD_S, of[N_X + r], length);
        memcpy(c->rows[row_of(stage, N_U + r)], of[BODY + r], length * sizeof(double));
    }
}

static void advance_body(const gtmr_controller *c, int stage, response of)
{
    double next[BODY][LD_V];
    const int length = PADDED((stage + 1) * N_U);
    const coefficients AB = {c->intervals[stage].jacobian[0], LD_XU, 1};
    for (int r = 0; r < BODY; ++r) {
        memset(next[r], 0, length * sizeof(double));
    }
    combine(BODY, length, N_XU, AB, of[0], LD_V, next[0], LD_V);
    for (int r = 0; r < BODY; ++r) {
        memcpy(of[r], next[r], length * sizeof(double));
    }
}

/* Row of the clearance one stage on, by its position, with attitude and margin held. */
static void clearance_row(gtmr_controller *c, int stage, response of)
{
    double *row = c->rows[row_of(stage, CLEARANCE)];
    const double *gradient = c->clearances[stage + 1].gradient;
    const int length = PADDED((stage + 1) * N_U);
    memset(row, 0, length * sizeof(double));
    add_scaled(row, gradient[0], of[0], length);
    add_scaled(row, gradient[1], of[1], length);
}

/* What the margin's gradient adds to it, by a backward sweep through the closed loop. */
static void add_margin_row(gtmr_controller *c, int stage)
{
    double d_x[STAGES + 1][N_X], d_u[STAGES][N_U], costate[LD_XU] = {0.0};
    double *row = c->rows[row_of(stage, CLEARANCE)];
    gtmr_margin_gradient(c, stage + 1, d_x, d_u);
    memcpy(costate, d_x[stage + 1], sizeof d_x[0]);
    for (int k = stage; k >= 0; --k) {
        const interval *at = &c->intervals[k];
        double back[LD_XU] = {0.0};
        for (int j = 0; j < N_U; ++j) {
            back[BODY + j] = d_x[k][BODY + j] + costate[BODY + j];
            back[N_X + j] = d_u[k][j] + PERIOD_S * costate[BODY + j];
        }
        memcpy(back, d_x[k], BODY * sizeof(double));
        const coefficients body = {costate, 0, 1};
        combine(1, LD_XU, BODY, body, at->jacobian[0], LD_XU, back, LD_XU);
        for (int j = 0; j < N_U; ++j) {
            double *entry = &row[k * N_U + j];
            for (int i = 0; i <= j; ++i) {
                *entry += at->whitening[j][i] * back[N_X + i];
            }
        }
        memcpy(costate, back, N_X * sizeof(double));
        const coefficients input = {back + N_X, 0, 1};
        combine(1, LD_X, N_U, input, at->gain[0], LD_X, costate, LD_X);
    }
}

static void measure_rows(gtmr_controller *c)
{
    for (int i = 0; i < N_ROWS; ++i) {
        const double norm = sqrt(dot(c->rows[i], c->rows[i], row_length(i)));
        c->inverse_norm[i] = norm > 0.0 ? 1.0 / norm : 0.0;
    }
}

void gtmr_condense(gtmr_controller *c)
{
    response of;
    memset(of, 0, sizeof of);
    for (int i = 0; i < STAGES; ++i) {
        input_rows(c, i, of);
        advance_body(c, i, of);
        speed_rows(c, i, of);
        clearance_row(c, i, of);
        if (with_margin_gradient(c)) {
            add_margin_row(c, i);
        }
    }
    measure_rows(c);
}
