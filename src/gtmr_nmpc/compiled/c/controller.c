// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* The memory of a controller; the first phase of a step, and where it starts from. */
#include <string.h>

#include "workspace.h"

size_t gtmr_size(void)
{
    return sizeof(struct gtmr_controller);
}

size_t gtmr_plan_length(void)
{
    return PLAN_LENGTH;
}

gtmr_controller *gtmr_create(void *memory, const gtmr_parameters *parameters)
{
    gtmr_controller *c = memory;
    memset(c, 0, sizeof *c);
    c->parameters = *parameters;
    for (int i = 0; i < STAGES; ++i) {
        for (int j = 0; j < 3; ++j) {
            c->intervals[i].jacobian[j][j] = 1.0;
        }
    }
    return c;
}

void gtmr_reconfigure(gtmr_controller *c, const gtmr_parameters *parameters)
{
    c->parameters = *parameters;
    c->progress.is_prepared = 0;
}

void gtmr_cold(gtmr_controller *c, const double *x)
{
    for (int i = 0; i <= STAGES; ++i) {
        memcpy(c->x[i], x, sizeof c->x[i]);
    }
    memset(c->u, 0, sizeof c->u);
    memset(c->multiplier, 0, sizeof c->multiplier);
    c->end_is_open = 0;
}

void gtmr_disturb(gtmr_controller *c, const double *theta)
{
    double left = 1.0;
    c->disturbed = theta != NULL;
    for (int i = 0; c->disturbed && i < STAGES; ++i, left *= c->parameters.gust_decay) {
        for (int j = 0; j < 3; ++j) {
            c->disturbance[i][j] = theta[j] + left * theta[3 + j];
            c->disturbance[i][3 + j] = theta[6 + j];
        }
    }
}

/* A stage with the rotors holding their speeds. */
static void coast(gtmr_controller *c, int stage, const double *x, double *next)
{
    for (int j = 0; j < N_X; ++j) {
        c->lanes_in[j] = vec_of(x[j]);
    }
    for (int j = 0; j < N_U; ++j) {
        c->lanes_in[N_X + j] = vec_of(0.0);
    }
    for (int which = 0; which < VEC; ++which) {
        gtmr_put_disturbance(c, stage, which);
    }
    gtmr_evaluate_model(c);
    memcpy(next, x, N_X * sizeof(double));
    for (int j = 0; j < BODY; ++j) {
        next[j] = *(const double *)(c->lanes_out + j);
    }
}

void gtmr_warm(gtmr_controller *c, int steps)
{
    const plan *last = &c->last;
    const int kept = STAGES - steps;
    memcpy(c->x, last->x[steps], (kept + 1) * sizeof c->x[0]);
    memcpy(c->u, last->u[steps], kept * sizeof c->u[0]);
    memcpy(c->multiplier, last->multiplier + steps * STAGE_ROWS,
           kept * STAGE_ROWS * sizeof(double));
    memset(c->u[kept], 0, steps * sizeof c->u[0]);
    memset(c->multiplier + kept * STAGE_ROWS, 0, steps * STAGE_ROWS * sizeof(double));
    /* The last state comes out of the linearisation of the last interval. */
    for (int i = kept; i < STAGES - 1; ++i) {
        coast(c, i, c->x[i], c->x[i + 1]);
    }
    c->end_is_open = kept < STAGES;
}

void gtmr_prepare(gtmr_controller *c, double t, double margin_scale)
{
    c->margin_scale = margin_scale;
    c->is_tightened = 0;
    c->has_margin_gradients = 0;
    gtmr_linearise(c, t);
    gtmr_clearance_along_iterate(c);
    gtmr_riccati_factorise(c);
}

int gtmr_guesses(const gtmr_controller *c)
{
    return c->guesses;
}

int gtmr_passes(const gtmr_controller *c)
{
    return c->passes;
}
