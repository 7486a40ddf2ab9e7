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

static void measure_row(gtmr_controller *c, int row)
{
    const double norm = sqrt(dot(c->rows[row], c->rows[row], row_length(row)));
    c->inverse_norm[row] = norm > 0.0 ? 1.0 / norm : 0.0;
}

/*
 * The clearances that count, on the way back through the stages. What is read as whole registers
 * was written as such: parts the processor would first have to see in memory.
 */
typedef struct {
    ALIGNED double later[STAGES][LD_X];    /* what the state behind a stage does to them */
    ALIGNED double back[STAGES][LD_XU];    /* what the stage's state and inputs do */
    ALIGNED double by_input[STAGES][LD_U]; /* the inputs alone */
    ALIGNED double minus[STAGES][LD_U];    /* what the stage's v does, negative */
    vec at_zero[STAGES];                   /* where v = 0, as sums of lanes */
    int stage_of[STAGES];
    int count;
} sweep;

/* Add products to what is summed lane by lane. */
static void add_products(vec *sums, const double *a, const double *b, int length)
{
    for (int j = 0; j < length; j += VEC) {
        *sums += load(a + j) * load(b + j);
    }
}

/* The clearance one stage on, with its margin, by its own state. */
static void begin_row(const gtmr_controller *c, int stage, sweep *s)
{
    double *of_state = s->later[s->count];
    const double *gradient = c->clearances[stage + 1].gradient;
    memset(of_state, 0, sizeof s->later[0]);
    if (with_margin_gradient(c)) {
        memcpy(of_state, gtmr_margin_gradient(c, stage + 1)[stage + 1], N_X * sizeof(double));
    }
    of_state[0] += gradient[0];
    of_state[1] += gradient[1];
    s->at_zero[s->count] = vec_of(0.0);
    s->stage_of[s->count] = stage;
    ++s->count;
}

/* From the state behind a stage to its own state and inputs. */
static void carry_back(const gtmr_controller *c, int stage, sweep *s)
{
    static const double zeros[LD_XU] = {0.0};
    const interval *at = &c->intervals[stage];
    const coefficients body = {s->later[0], LD_X, 1};
    const beginning none = {zeros, 0, 1.0}, margins = {s->back[0], LD_XU, 1.0};
    const int with_margins = with_margin_gradient(c);
    ALIGNED double rotors[LD_X];
    for (int j = 0; j < LD_X; ++j) {
        rotors[j] = j >= BODY && j < N_X ? 1.0 : 0.0;
    }
    for (int i = 0; i < s->count && with_margins; ++i) {
        memcpy(s->back[i], gtmr_margin_gradient(c, s->stage_of[i] + 1)[stage], sizeof s->back[i]);
    }
    combine_from(s->count, LD_XU, BODY, body, at->jacobian[0], LD_XU,
                 with_margins ? margins : none, s->back[0], LD_XU);
    for (int i = 0; i < s->count; ++i) {
        double *later = s->later[i], *back = s->back[i];
        add_products(&s->at_zero[i], later, at->defect, LD_X);
        for (int r = 0; r < N_U; ++r) {
            s->by_input[i][r] = back[N_X + r] + PERIOD_S * later[BODY + r];
        }
        for (int j = 0; j < LD_X; j += VEC) {
            store(back + j, load(back + j) + load(rotors + j) * load(later + j));
        }
    }
}

/* Let a stage's inputs follow their law: what they do becomes what its state and v do. */
static void close_loop(const gtmr_controller *c, int stage, sweep *s)
{
    static const double zeros[LD_U] = {0.0};
    const law *at = law_of(c, stage);
    const coefficients inputs = {s->by_input[0], LD_U, 1}, free = {s->minus[0], LD_U, 1};
    const beginning none = {zeros, 0, 1.0}, from = {s->back[0], LD_XU, 1.0};
    ALIGNED double whitening[N_U][LD_U] = {{0.0}};
    if (has_slopes(at)) {
        ALIGNED double slopes[N_U][LD_X] = {{0.0}};
        for (int r = 0; r < N_U; ++r) {
            slopes[r][BODY + r] = at->slope[r];
        }
        combine(s->count, LD_X, N_U, inputs, slopes[0], LD_X, s->back[0], LD_XU);
    }
    UNROLL for (int r = 0; r < N_U; ++r)
    {
        UNROLL for (int j = 0; j < N_U; ++j)
        {
            whitening[j][r] = -at->whitening[r][j];
        }
    }
    combine_from(s->count, LD_U, N_U, inputs, whitening[0], LD_U, none, s->minus[0], LD_U);
    combine_from(s->count, LD_X, N_U, free, at->Z[0], LD_X, from, s->later[0], LD_X);
    for (int i = 0; i < s->count; ++i) {
        add_products(&s->at_zero[i], s->minus[i], at->z, LD_U);
        add_products(&s->at_zero[i], s->by_input[i], at->offset, LD_U);
    }
}

static void keep_rows(gtmr_controller *c, int stage, sweep *s)
{
    const int before = stage * N_U;
    for (int i = 0; i < s->count; ++i) {
        double *row = c->rows[row_of(s->stage_of[i], CLEARANCE)];
        for (int j = 0; j < LD_U; j += VEC) {
            store(s->minus[i] + j, -load(s->minus[i] + j));
        }
        memcpy(row + before, s->minus[i], N_U * sizeof(double));
        memcpy(c->by_input[s->stage_of[i]] + before, s->by_input[i], N_U * sizeof(double));
    }
}

/* The rows of the clearances that count and their values at v = 0, by one sweep backwards. */
static void clearance_rows(gtmr_controller *c, const double *dx0)
{
    sweep s;
    ALIGNED double start[LD_X] = {0.0};
    if (with_margin_gradient(c)) {
        gtmr_find_margin_gradients(c);
    }
    s.count = 0;
    memset(s.by_input, 0, sizeof s.by_input);
    for (int k = STAGES - 1; k >= 0; --k) {
        if (c->counts[k]) {
            begin_row(c, k, &s);
        }
        carry_back(c, k, &s);
        close_loop(c, k, &s);
        keep_rows(c, k, &s);
    }
    memcpy(start, dx0, N_X * sizeof(double));
    for (int i = 0; i < s.count; ++i) {
        const int row = row_of(s.stage_of[i], CLEARANCE);
        add_products(&s.at_zero[i], s.later[i], start, LD_X);
        c->value[row] = c->clearances[s.stage_of[i] + 1].residual + sum(s.at_zero[i]);
        measure_row(c, row);
    }
}

void gtmr_condense(gtmr_controller *c, const double *dx0)
{
    response of;
    memset(of, 0, sizeof of);
    for (int i = 0; i < STAGES; ++i) {
        input_rows(c, i, of);
        advance_body(c, i, of);
        speed_rows(c, i, of);
        for (int r = 0; r < 2 * N_U; ++r) {
            measure_row(c, row_of(i, r));
        }
        c->counts[i] = 1;
    }
    clearance_rows(c, dx0);
    c->only_clearances = 0;
}

void gtmr_condense_clearances(gtmr_controller *c, const double *dx0)
{
    memset(c->inverse_norm, 0, sizeof c->inverse_norm);
    clearance_rows(c, dx0);
    c->only_clearances = 1;
}

void gtmr_clearance_forces(const gtmr_controller *c, double forces[STAGES][N_U])
{
    memset(forces, 0, STAGES * sizeof forces[0]);
    for (int i = 0; i < STAGES; ++i) {
        const double by = c->last.multiplier[row_of(i, CLEARANCE)];
        for (int k = 0; k <= i && by != 0.0; ++k) {
            for (int r = 0; r < N_U; ++r) {
                forces[k][r] += by * c->by_input[i][k * N_U + r];
            }
        }
    }
}
