// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* Dynamics and cost along the iterate, as many shooting intervals at once as a register holds. */
#include <string.h>

#include "combine.h"
#include "workspace.h"

/* Where the model's sparse outputs go: from a nonzero, to an entry. */
typedef struct {
    unsigned short from;
    unsigned short to;
} move;

static const move JACOBIAN_MOVE[JACOBIAN_NONZEROS] = {JACOBIAN_MOVES(LD_XU)};
static const move DF_DZETA_MOVE[DF_DZETA_NONZEROS] = {DF_DZETA_MOVES(LD_ZETA)};
static const short OUTPUT_STATE[N_H] = {OUTPUT_STATES};

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
    gtmr_put_disturbance(c, stage, which);
}

void gtmr_put_disturbance(gtmr_controller *c, int stage, int which)
{
    for (int j = 0; c->disturbed && j < N_DISTURBED; ++j) {
        *lane(c->lanes_in, N_XU + j, which) = c->disturbance[stage][j];
    }
}

/* Without disturbances the model is the paper's to the last digit. */
void gtmr_evaluate_model(gtmr_controller *c)
{
    if (c->disturbed) {
        gtmr_model_linearise_disturbed(c->lanes_in, c->lanes_out);
    } else {
        gtmr_model_linearise(c->lanes_in, c->lanes_out);
    }
}

static void take(gtmr_controller *c, int stage, int which)
{
    interval *to = &c->intervals[stage];
    const double *x = c->x[stage];
    double *x_planned = c->x[stage + 1];
    const double *from = lane(c->lanes_out, 0, which);
    double *jacobian = &to->jacobian[0][0], *dF_dzeta = &to->dF_dzeta[0][0];
    if (stage == STAGES - 1 && c->end_is_open) {
        memcpy(x_planned, x, N_X * sizeof(double));
        for (int j = 0; j < BODY; ++j) {
            x_planned[j] = from[j * VEC];
        }
    }
    for (int j = 0; j < BODY; ++j, from += VEC) {
        to->defect[j] = *from - x_planned[j];
    }
    for (int j = 0; j < N_U; ++j) {
        to->defect[BODY + j] = x[BODY + j] + PERIOD_S * c->u[stage][j] - x_planned[BODY + j];
    }
    for (int j = 0; j < 3; ++j, from += VEC) {
        to->acceleration[j] = *from;
    }
    UNROLL_ALL for (int j = 0; j < JACOBIAN_NONZEROS; ++j)
    {
        jacobian[JACOBIAN_MOVE[j].to] = from[JACOBIAN_MOVE[j].from * VEC];
    }
    from += JACOBIAN_NONZEROS * VEC;
    if (is_robust(c)) {
        UNROLL_ALL for (int j = 0; j < DF_DZETA_NONZEROS; ++j)
        {
            dF_dzeta[DF_DZETA_MOVE[j].to] = from[DF_DZETA_MOVE[j].from * VEC];
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
    memset(gradient, 0, sizeof c->cost_gradient[stage]);
    for (int j = 0, i = 0; j < N_H; ++j) {
        const int state = OUTPUT_STATE[j];
        if (state < 0) {
            by_acceleration[i] = w[j] * (at->acceleration[i] - reference[j]);
            ++i;
        } else {
            gradient[state] = w[j] * (x[state] - reference[j]);
        }
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

void gtmr_linearise(gtmr_controller *c, double t)
{
    double follow[3 + sizeof c->parameters.reference / sizeof(double)];
    follow[1] = c->parameters.tower_radius_m;
    follow[2] = c->parameters.min_clearance_m;
    memcpy(follow + 3, c->parameters.reference, sizeof c->parameters.reference);
    for (int first = 0; first < STAGES; first += VEC) {
        for (int which = 0; which < VEC; ++which) {
            put(c, smaller(first + which, STAGES - 1), which);
        }
        gtmr_evaluate_model(c);
        for (int which = 0; which < smaller(VEC, STAGES - first); ++which) {
            take(c, first + which, which);
        }
    }
    for (int i = 0; i <= STAGES; ++i) {
        double reference[N_H];
        follow[0] = t + i * PERIOD_S;
        gtmr_model_reference(follow, reference);
        if (i < STAGES) {
            cost_gradient(c, i, reference);
        } else {
            terminal_gradient(c, reference);
        }
    }
}
