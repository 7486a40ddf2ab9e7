// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* What block pivoting finds for a stage: bounds, inputs, multipliers. */
#ifndef GTMR_PIVOTING_H
#define GTMR_PIVOTING_H

#include "workspace.h"

enum { NONE = -1 };

/* An input that breaks a bound by less is at it [Hz/s]. */
#define INPUT_ROUNDING 1e-9

/* Bounds of a stage's step of the inputs, and what makes each. */
typedef struct {
    double lower[N_U];
    double upper[N_U];
    signed char at_lower[N_U];
    signed char at_upper[N_U];
} stage_bounds;

/* Inputs of a stage and their multipliers: positive at an upper bound. */
typedef struct {
    signed char side[N_U];
    double du[N_U];
    double multiplier[N_U];
} stage_solution;

/* guesses.c: what is held. */

/* The guess that the multipliers of the last QP are; the last stage at which something is held. */
int gtmr_first_guess(gtmr_controller *c);

/* Laws of the inputs that are held, by the state. */
void gtmr_hold(gtmr_controller *c);

/* Bounds of a stage's inputs; of one that leads to a corner both are what leads there. */
stage_bounds gtmr_bounds_of(const gtmr_controller *c, int stage, const double *dx);

/* Let an input lead to the corner of a stage that is at its bound, if there is a free one before. */
int gtmr_lead_to_corner(gtmr_controller *c, int stage, int rotor, int side);

/* stage.c */

/*
 * Minimise du' Q du / 2 + g' du within bounds, from a guess of the sides, and of the inputs: those at
 * no side are right where the others are at their bounds. Returns 0 if it does not settle.
 */
int gtmr_solve_stage(const input_cost *cost, const double *g, const stage_bounds *within,
                     stage_solution *s);

static inline int leads(int held)
{
    return held == TO_CORNER || held == -TO_CORNER;
}

static inline int is_at_input(int held)
{
    return held == AT_INPUT || held == -AT_INPUT;
}

static inline int is_at_speed(int held)
{
    return held == AT_SPEED || held == -AT_SPEED;
}

#endif
