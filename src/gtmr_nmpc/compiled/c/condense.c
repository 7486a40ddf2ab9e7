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
    const law *at = &c->laws[stage];
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

/*
 * Entries of a row by the stage's v, and by how much its state counts with the inputs following
 * their law.
 */
static void close_loop(const law *at, const double *back, double *row, double *costate)
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
    for (int r = 0; r < N_U; ++r) {
        costate[BODY + r] += at->slope[r] * back[N_X + r];
    }
    const coefficients by = {minus, 0, 1};
    combine(1, LD_X, N_U, by, at->Z[0], LD_X, costate, LD_X);
}

/* What the margin's gradient adds to the row of the clearance one stage on. */
static void add_margin_row(gtmr_controller *c, int stage)
{
    const double(*gradient)[LD_XU] = gtmr_margin_gradient(c, stage + 1);
    double *row = c->rows[row_of(stage, CLEARANCE)], costate[LD_XU];
    memcpy(costate, gradient[stage + 1], sizeof costate);
    for (int k = stage; k >= 0; --k) {
        double back[LD_XU];
        memcpy(back, gradient[k], sizeof back);
        carry_back(&c->intervals[k], costate, back);
        close_loop(law_of(c, k), back, row + k * N_U, costate);
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

/* Before it all inputs are held, so that no row has an entry there. */
static int first_free_stage(const gtmr_controller *c)
{
    for (int i = 0; i < c->held_stages; ++i) {
        for (int r = 0; r < N_U; ++r) {
            if (c->held[i][r] == FREE) {
                return i;
            }
        }
    }
    return c->held_stages;
}

/* The rows of all clearances with their margins, by one backward sweep. */
static void clearance_rows(gtmr_controller *c)
{
    static const double zero[PADDED(N_U)] = {0.0};
    double later[STAGES][LD_X], back[STAGES][LD_XU];
    const int first = first_free_stage(c);
    memset(later, 0, sizeof later);
    for (int k = STAGES - 1; k >= first; --k) {
        const interval *stage = &c->intervals[k];
        const law *at = law_of(c, k);
        const int count = STAGES - k;
        double(*from)[LD_X] = later + k, (*to)[LD_XU] = back + k;
        if (with_margin_gradient(c)) {
            memcpy(from[0], gtmr_margin_gradient(c, k + 1)[k + 1], N_X * sizeof(double));
        }
        from[0][0] += c->clearances[k + 1].gradient[0];
        from[0][1] += c->clearances[k + 1].gradient[1];
        for (int i = 0; i < count; ++i) {
            if (with_margin_gradient(c)) {
                memcpy(to[i], gtmr_margin_gradient(c, k + i + 1)[k], sizeof to[i]);
            } else {
                memset(to[i], 0, sizeof to[i]);
            }
            for (int j = 0; j < N_U; ++j) {
                to[i][BODY + j] += from[i][BODY + j];
                to[i][N_X + j] += PERIOD_S * from[i][BODY + j];
            }
        }
        const coefficients body = {from[0], LD_X, 1};
        combine(count, LD_XU, BODY, body, stage->jacobian[0], LD_XU, to[0], LD_XU);
        double minus[STAGES][PADDED(N_U)], negative[N_U][PADDED(N_U)] = {{0.0}};
        for (int r = 0; r < N_U; ++r) {
            for (int j = 0; j <= r; ++j) {
                negative[j][r] = -at->whitening[r][j];
            }
        }
        const coefficients of_inputs = {to[0] + N_X, LD_XU, 1};
        const beginning none = {zero, 0, 1.0};
        combine_from(count, PADDED(N_U), N_U, of_inputs, negative[0], PADDED(N_U), none, minus[0],
                     PADDED(N_U));
        for (int i = 0; i < count; ++i) {
            double *row = c->rows[row_of(k + i, CLEARANCE)] + k * N_U;
            for (int r = 0; r < N_U; ++r) {
                row[r] = -minus[i][r];
                to[i][BODY + r] += at->slope[r] * to[i][N_X + r];
            }
        }
        const coefficients inputs = {minus[0], PADDED(N_U), 1};
        const beginning held = {to[0], LD_XU, 1.0};
        combine_from(count, LD_X, N_U, inputs, at->Z[0], LD_X, held, from[0], LD_X);
    }
    for (int i = 0; i < STAGES; ++i) {
        const int zeros = i < first ? (i + 1) * N_U : first * N_U;
        memset(c->rows[row_of(i, CLEARANCE)], 0, zeros * sizeof(double));
    }
}

void gtmr_condense_clearances(gtmr_controller *c)
{
    memset(c->inverse_norm, 0, sizeof c->inverse_norm);
    clearance_rows(c);
    for (int i = 0; i < STAGES; ++i) {
        measure_row(c, row_of(i, CLEARANCE));
    }
    c->only_clearances = 1;
}

void gtmr_clearance_forces(gtmr_controller *c, double forces[STAGES][N_U])
{
    double back[STAGES + 1][LD_XU], costate[LD_XU];
    memset(back, 0, sizeof back);
    for (int i = 1; i <= STAGES; ++i) {
        const double by = c->last.multiplier[row_of(i - 1, CLEARANCE)];
        if (by != 0.0) {
            back[i][0] += by * c->clearances[i].gradient[0];
            back[i][1] += by * c->clearances[i].gradient[1];
            if (with_margin_gradient(c)) {
                const double(*gradient)[LD_XU] = gtmr_margin_gradient(c, i);
                for (int k = 0; k <= i; ++k) {
                    add_scaled(back[k], by, gradient[k], LD_XU);
                }
            }
        }
    }
    memcpy(costate, back[STAGES], sizeof costate);
    for (int k = STAGES - 1; k >= 0; --k) {
        double row[N_U] = {0.0};
        carry_back(&c->intervals[k], costate, back[k]);
        memcpy(forces[k], back[k] + N_X, sizeof forces[k]);
        close_loop(law_of(c, k), back[k], row, costate);
        for (int r = 0; r < N_U; ++r) {
            c->v[k * N_U + r] = -row[r];
        }
    }
}
