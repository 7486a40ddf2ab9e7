// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* The step of the iterate that a law of feedback makes, stage by stage. */
#include <string.h>

#include "combine.h"
#include "workspace.h"

void gtmr_law_input(const law *at, const double *dx, const double *v, double *du)
{
    double free[N_U], inputs[LD_U] = {0.0};
    for (int r = 0; r < N_U; ++r) {
        free[r] = v[r] - at->z[r] - dot(at->Z[r], dx, LD_X);
    }
    const coefficients by = {free, 0, 1};
    combine(1, LD_U, N_U, by, at->whitening[0], LD_U, inputs, LD_U);
    for (int r = 0; r < N_U; ++r) {
        du[r] = inputs[r] + at->offset[r] + at->slope[r] * dx[BODY + r];
    }
}

void gtmr_advance(const interval *at, const double *now, double *next)
{
    for (int r = 0; r < BODY; ++r) {
        next[r] = at->defect[r] + dot(at->jacobian[r], now, LD_XU);
    }
    for (int r = 0; r < N_U; ++r) {
        next[BODY + r] = at->defect[BODY + r] + now[BODY + r] + PERIOD_S * now[N_X + r];
    }
}

void gtmr_rollout(gtmr_controller *c, const double *dx0, const double *v)
{
    static const double none[N_U] = {0.0};
    memset(c->step, 0, sizeof c->step);
    memcpy(c->step[0], dx0, N_X * sizeof(double));
    for (int i = 0; i < STAGES; ++i) {
        double *now = c->step[i];
        gtmr_law_input(law_of(c, i), now, v != NULL ? v + i * N_U : none, now + N_X);
        gtmr_advance(&c->intervals[i], now, c->step[i + 1]);
    }
}

static double between(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

/*
 * Cut the inputs of a stage so that they and the next speeds keep their bounds. Any speed that
 * `bound_rotor` asks for is in reach, so that stage by stage there is an input for it.
 */
static void keep_within(const gtmr_controller *c, int stage, double *now)
{
    for (int r = 0; r < N_U; ++r) {
        const int input = row_of(stage, r), speed = row_of(stage, N_U + r);
        const double xi = c->x[stage][BODY + r] + now[BODY + r];
        double u = c->u[stage][r] + now[N_X + r];
        u = between(u, (c->lower[speed] - xi) / PERIOD_S, (c->upper[speed] - xi) / PERIOD_S);
        u = between(u, c->lower[input], c->upper[input]);
        now[N_X + r] = u - c->u[stage][r];
    }
}

void gtmr_rollout_within(gtmr_controller *c, const double *dx0, const double *v)
{
    memset(c->step, 0, sizeof c->step);
    memcpy(c->step[0], dx0, N_X * sizeof(double));
    for (int i = 0; i < STAGES; ++i) {
        double *now = c->step[i];
        gtmr_law_input(&c->laws[i], now, v + i * N_U, now + N_X);
        keep_within(c, i, now);
        gtmr_advance(&c->intervals[i], now, c->step[i + 1]);
    }
}
