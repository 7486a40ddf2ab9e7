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
    double gain[N_U][LD_X];
    gtmr_riccati_gain(at, gain);
    for (int r = 0; r < N_U; ++r) {
        memset(of[N_X + r], 0, length * sizeof(double));
        for (int k = r; k < N_U; ++k) {
            of[N_X + r][before + k] = at->whitening[k][r];
        }
    }
    const coefficients K = {gain[0], LD_X, 1};
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

/* By how much the state and the input of a stage count, of how much the state after it does. */
static void carry_back(const interval *at, const double *later, double *back)
{
    for (int j = 0; j < N_U; ++j) {
        back[BODY + j] += later[BODY + j];
        back[N_X + j] += PERIOD_S * later[BODY + j];
    }
    const coefficients body = {later, 0, 1};
    combine(1, LD_XU, BODY, body, at->jacobian[0], LD_XU, back, LD_XU);
}

/* Entries of a row by the stage's v, and by how much its state counts with the inputs following. */
static void close_loop(const interval *at, const double *back, double *row, double *costate)
{
    double minus[N_U];
    for (int r = 0; r < N_U; ++r) {
        double entry = 0.0;
        for (int k = 0; k <= r; ++k) {
            entry += at->whitening[r][k] * back[N_X + k];
        }
        row[r] += entry;
        minus[r] = -entry;
    }
    memcpy(costate, back, N_X * sizeof(double));
    const coefficients by = {minus, 0, 1};
    combine(1, LD_X, N_U, by, at->Z[0], LD_X, costate, LD_X);
}

/* What the margin's gradient adds to the row of the clearance one stage on. */
static void add_margin_row(gtmr_controller *c, int stage)
{
    double d_x[STAGES + 1][N_X], d_u[STAGES][N_U], costate[LD_XU] = {0.0};
    double *row = c->rows[row_of(stage, CLEARANCE)];
    gtmr_margin_gradient(c, stage + 1, d_x, d_u);
    memcpy(costate, d_x[stage + 1], sizeof d_x[0]);
    for (int k = stage; k >= 0; --k) {
        double back[LD_XU] = {0.0};
        memcpy(back, d_x[k], sizeof d_x[k]);
        memcpy(back + N_X, d_u[k], sizeof d_u[k]);
        carry_back(&c->intervals[k], costate, back);
        close_loop(&c->intervals[k], back, row + k * N_U, costate);
    }
}

static void measure_row(gtmr_controller *c, int row)
{
    const double norm = sqrt(dot(c->rows[row], c->rows[row], row_length(row)));
    c->inverse_norm[row] = norm > 0.0 ? 1.0 / norm : 0.0;
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
    for (int i = 0; i < N_ROWS; ++i) {
        measure_row(c, i);
    }
    c->only_clearances = 0;
}

/* The rows of all clearances, by one backward sweep. */
static void clearance_rows(gtmr_controller *c)
{
    double later[STAGES][LD_X], back[STAGES][LD_XU];
    memset(later, 0, sizeof later);
    for (int k = STAGES - 1; k >= 0; --k) {
        const interval *at = &c->intervals[k];
        const int count = STAGES - k;
        double(*from)[LD_X] = later + k, (*to)[LD_XU] = back + k;
        from[0][0] = c->clearances[k + 1].gradient[0];
        from[0][1] = c->clearances[k + 1].gradient[1];
        for (int i = 0; i < count; ++i) {
            memset(to[i], 0, sizeof to[i]);
            for (int j = 0; j < N_U; ++j) {
                to[i][BODY + j] = from[i][BODY + j];
                to[i][N_X + j] = PERIOD_S * from[i][BODY + j];
            }
        }
        const coefficients body = {from[0], LD_X, 1};
        combine(count, LD_XU, BODY, body, at->jacobian[0], LD_XU, to[0], LD_XU);
        double minus[STAGES][N_U];
        for (int i = 0; i < count; ++i) {
            double *row = c->rows[row_of(k + i, CLEARANCE)] + k * N_U;
            for (int r = 0; r < N_U; ++r) {
                double entry = 0.0;
                for (int j = 0; j <= r; ++j) {
                    entry += at->whitening[r][j] * to[i][N_X + j];
                }
                row[r] = entry;
                minus[i][r] = -entry;
            }
        }
        const coefficients inputs = {minus[0], N_U, 1};
        const beginning held = {to[0], LD_XU, 1.0};
        combine_from(count, LD_X, N_U, inputs, at->Z[0], LD_X, held, from[0], LD_X);
    }
}

void gtmr_condense_clearances(gtmr_controller *c)
{
    memset(c->inverse_norm, 0, sizeof c->inverse_norm);
    clearance_rows(c);
    for (int i = 0; i < STAGES; ++i) {
        if (with_margin_gradient(c)) {
            add_margin_row(c, i);
        }
        measure_row(c, row_of(i, CLEARANCE));
    }
    c->only_clearances = 1;
}
