// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* Dynamics and cost along the iterate, as many shooting intervals at once as a register holds. */
#include <string.h>

#include "workspace.h"

/* Where the model's sparse outputs go. */
static const unsigned short JACOBIAN_AT[JACOBIAN_NONZEROS] = {JACOBIAN_PLACES(LD_XU)};
static const unsigned short DF_DZETA_AT[DF_DZETA_NONZEROS] = {DF_DZETA_PLACES(LD_ZETA)};

static double *lane(vec *lanes, int entry, int which)
{
    return (double *)(lanes + entry) + which;
}

static int smaller(int a, int b)
{
    return a < b ? a : b;
}

static void put(gtmr_controller *c, int stage, int which)
{
    for (int j = 0; j < N_X; ++j) {
        *lane(c->lanes_in, j, which) = c->x[stage][j];
    }
    for (int j = 0; j < N_U; ++j) {
        *lane(c->lanes_in, N_X + j, which) = c->u[stage][j];
    }
}

static void take(gtmr_controller *c, int stage, int which)
{
    interval *to = &c->intervals[stage];
    const double *x = c->x[stage], *x_planned = c->x[stage + 1];
    const double *from = lane(c->lanes_out, 0, which);
    double *jacobian = &to->jacobian[0][0], *dF_dzeta = &to->dF_dzeta[0][0];
    for (int j = 0; j < BODY; ++j, from += VEC) {
        to->defect[j] = *from - x_planned[j];
    }
    for (int j = 0; j < N_U; ++j) {
        to->defect[BODY + j] = x[BODY + j] + PERIOD_S * c->u[stage][j] - x_planned[BODY + j];
    }
    for (int j = 0; j < 3; ++j, from += VEC) {
        to->acceleration[j] = *from;
    }
    for (int j = 0; j < JACOBIAN_NONZEROS; ++j, from += VEC) {
        jacobian[JACOBIAN_AT[j]] = *from;
    }
    if (is_robust(c)) {
        for (int j = 0; j < DF_DZETA_NONZEROS; ++j, from += VEC) {
            dF_dzeta[DF_DZETA_AT[j]] = *from;
        }
    }
}

/* Half the gradient of the stage cost with respect to the state. */
static void cost_gradient(gtmr_controller *c, int stage, const double *reference)
{
    const double *w = c->parameters.stage_weights, *x = c->x[stage];
    const interval *at = &c->intervals[stage];
    double *gradient = c->cost_gradient[stage];
    double by_acceleration[3];
    for (int j = 0; j < 3; ++j) {
        gradient[j] = w[j] * (x[j] - reference[j]);
        gradient[6 + j] = w[3 + j] * (x[6 + j] - reference[3 + j]);
        by_acceleration[j] = w[6 + j] * (at->acceleration[j] - reference[6 + j]);
        gradient[3 + j] = w[9 + j] * (x[3 + j] - reference[9 + j]);
        gradient[9 + j] = w[12 + j] * (x[9 + j] - reference[12 + j]);
    }
    for (int j = BODY; j < N_X; ++j) {
        gradient[j] = 0.0;
    }
    for (int i = 0; i < 3; ++i) {
        for (int j = 3; j < N_X; ++j) {
            gradient[j] += by_acceleration[i] * at->jacobian[BODY + i][j];
        }
    }
}

static void terminal_gradient(gtmr_controller *c, const double *reference)
{
    double *gradient = c->cost_gradient[STAGES];
    memset(gradient, 0, sizeof c->cost_gradient[STAGES]);
    for (int j = 0; j < 3; ++j) {
        gradient[j] = c->parameters.terminal_weights[j] * (c->x[STAGES][j] - reference[j]);
    }
}

void linearise(gtmr_controller *c, double t)
{
    for (int first = 0; first < STAGES; first += VEC) {
        for (int which = 0; which < VEC; ++which) {
            put(c, smaller(first + which, STAGES - 1), which);
        }
        model_linearise(c->lanes_in, c->lanes_out);
        for (int which = 0; which < smaller(VEC, STAGES - first); ++which) {
            take(c, first + which, which);
        }
    }
    for (int i = 0; i <= STAGES; ++i) {
        double reference[N_H];
        helix_reference(&c->parameters, t + i * PERIOD_S, reference);
        if (i < STAGES) {
            cost_gradient(c, i, reference);
        } else {
            terminal_gradient(c, reference);
        }
    }
}
