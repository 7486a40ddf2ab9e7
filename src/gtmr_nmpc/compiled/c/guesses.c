// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* Which inputs are held, and where that puts them. */
#include <string.h>

#include "pivoting.h"

/* Whether it is the next speed that is to be somewhere. */
static int wants_speed(int held)
{
    return is_at_speed(held) || leads(held);
}

/* The next speed that is wanted at a stage [Hz]. */
static double wanted_speed(const gtmr_controller *c, int stage, int rotor, int held)
{
    const int at = leads(held) ? c->corner[stage][rotor] : stage;
    double speed = (held > 0 ? c->upper : c->lower)[row_of(at, N_U + rotor)];
    for (int i = at; i > stage; --i) {
        speed -= PERIOD_S * (c->held[i][rotor] > 0 ? c->upper : c->lower)[row_of(i, rotor)];
    }
    return speed;
}

stage_bounds gtmr_bounds_of(const gtmr_controller *c, int stage, const double *dx)
{
    stage_bounds of;
    for (int r = 0; r < N_U; ++r) {
        const int input = row_of(stage, r), was = c->held[stage][r];
        const double xi = c->x[stage][BODY + r] + dx[BODY + r], u = c->u[stage][r];
        const double least = (c->lower[row_of(stage, N_U + r)] - xi) / PERIOD_S;
        const double most = (c->upper[row_of(stage, N_U + r)] - xi) / PERIOD_S;
        /* Where both are the same, it stays the one that it was. */
        const double tie = wants_speed(was) ? -INPUT_ROUNDING : INPUT_ROUNDING;
        of.at_lower[r] = least > c->lower[input] + tie ? -AT_SPEED : -AT_INPUT;
        of.at_upper[r] = most < c->upper[input] - tie ? AT_SPEED : AT_INPUT;
        of.lower[r] = (of.at_lower[r] == -AT_SPEED ? least : c->lower[input]) - u;
        of.upper[r] = (of.at_upper[r] == AT_SPEED ? most : c->upper[input]) - u;
        if (leads(was)) {
            const double du = (wanted_speed(c, stage, r, was) - xi) / PERIOD_S - u;
            /* Out of reach, it is let go. */
            if (du > of.lower[r] - INPUT_ROUNDING && du < of.upper[r] + INPUT_ROUNDING) {
                of.lower[r] = of.upper[r] = du;
                of.at_lower[r] = of.at_upper[r] = (signed char)was;
            }
        }
    }
    return of;
}

int gtmr_lead_to_corner(gtmr_controller *c, int stage, int rotor, int side)
{
    int from = stage - 1;
    while (from >= 0 && is_at_input(c->held[from][rotor])) {
        --from;
    }
    if (from < 0 || c->held[from][rotor] != FREE) {
        return 0;
    }
    c->held[from][rotor] = (signed char)(side * TO_CORNER);
    c->corner[from][rotor] = stage;
    return 1;
}

void gtmr_hold(gtmr_controller *c)
{
    for (int i = 0; i < STAGES; ++i) {
        law *at = &c->held_laws[i];
        for (int r = 0; r < N_U; ++r) {
            const int held = c->held[i][r];
            const double u = c->u[i][r], xi = c->x[i][BODY + r];
            at->offset[r] = at->slope[r] = 0.0;
            if (wants_speed(held)) {
                at->offset[r] = (wanted_speed(c, i, r, held) - xi) / PERIOD_S - u;
                at->slope[r] = -1.0 / PERIOD_S;
            } else if (held != FREE) {
                at->offset[r] = (held > 0 ? c->upper : c->lower)[row_of(i, r)] - u;
            }
        }
    }
}

int gtmr_first_guess(gtmr_controller *c)
{
    int last = NONE;
    memset(c->swaps, 0, sizeof c->swaps);
    for (int i = 0; i < STAGES; ++i) {
        for (int r = 0; r < N_U; ++r) {
            const int input = row_of(i, r), speed = row_of(i, N_U + r);
            const double by_input = c->multiplier[input], by_speed = c->multiplier[speed];
            const int side = by_speed > 0.0 ? 1 : -1;
            /* A speed that is out of its bounds may have none now. */
            const int bounded = fabs(side > 0 ? c->upper[speed] : c->lower[speed]) < HUGE_VAL;
            signed char held = by_input > 0.0 ? AT_INPUT : by_input < 0.0 ? -AT_INPUT : FREE;
            if (by_speed != 0.0 && bounded &&
                !(held == side * AT_INPUT && gtmr_lead_to_corner(c, i, r, side))) {
                held = (signed char)(side * AT_SPEED);
            }
            c->held[i][r] = held;
            last = held != FREE ? i : last;
        }
    }
    return last;
}

