// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/*
 * The QP by block pivoting on the bounds of the rotors, which the Riccati recursion takes stage by
 * stage: of every input it is guessed whether it is free, at its bound, or where the rotor's next
 * speed is at its bound. With that guess the recursion gives laws of feedback, the clearances are
 * solved by the active set, and a forward pass solves every stage's inputs within their bounds,
 * the stages behind it following their laws. What it finds is the next guess. Where it finds the
 * guess itself, all conditions of optimality hold. A few guesses suffice but for rare QPs, which
 * are left to the active set.
 */
#include <string.h>

#include "combine.h"
#include "pivoting.h"

/* Guesses that a step may take. No more than 9 are needed but in one QP of some thousand. */
#ifndef GTMR_MAX_GUESSES
#define GTMR_MAX_GUESSES 10
#endif

/* Swaps between two bounds after which a rotor is taken to be at both. */
enum { SWAPS = 3 };

/* What is held, of all stages. */
typedef signed char guess[STAGES][N_U];

/* Whether a law's inputs keep all bounds. */
static int keeps(const stage_bounds *within, const double *du)
{
    int good = 1;
    for (int r = 0; r < N_U; ++r) {
        good &= (du[r] <= within->upper[r] + INPUT_ROUNDING) &
                (du[r] >= within->lower[r] - INPUT_ROUNDING);
    }
    return good;
}

static int holds_any(const gtmr_controller *c, int stage)
{
    int any = 0;
    for (int r = 0; r < N_U; ++r) {
        any |= c->held[stage][r] != FREE;
    }
    return any;
}

/* Cut inputs to their bounds: where no Hessian was kept it is only a guess that they are there. */
static void cut(const stage_bounds *within, stage_solution *s)
{
    for (int r = 0; r < N_U; ++r) {
        s->side[r] = s->du[r] > within->upper[r] + INPUT_ROUNDING   ? 1
                     : s->du[r] < within->lower[r] - INPUT_ROUNDING ? -1
                                                                    : 0;
        s->du[r] = s->side[r] > 0 ? within->upper[r] : s->side[r] < 0 ? within->lower[r] : s->du[r];
    }
}

/* Corners on the way forward, by rotor. */
typedef struct {
    int from[N_U];    /* the stage that leads there */
    int at[N_U];      /* the stage of the corner, NONE if there is none ahead */
    double pull[N_U]; /* by which its speed pulls at every input on the way */
} corners;

/* Whether a rotor swaps between the bounds of its input and speed: it is at both then. */
static int swaps_again(gtmr_controller *c, int stage, int rotor, int held)
{
    const int was = c->held[stage][rotor], both = AT_INPUT + AT_SPEED;
    const int swap = was != held && (was + held == both || was + held == -both);
    c->swaps[stage][rotor] += (signed char)swap;
    return swap && c->swaps[stage][rotor] >= SWAPS;
}

/*
 * Go on along the way to a corner, if the rotor is on one. What is found for an input may end it:
 * a multiplier of the speed that has the wrong sign, an input that leaves its bound.
 */
static signed char on_the_way(gtmr_controller *c, int stage, int rotor, signed char held,
                              double multiplier, corners *to)
{
    const int was = c->held[stage][rotor];
    if (to->at[rotor] == NONE) {
        if (!leads(held)) {
            return held;
        }
        if (multiplier * held < 0.0) {
            return FREE;
        }
        to->at[rotor] = c->corner[stage][rotor];
        to->from[rotor] = stage;
        to->pull[rotor] = multiplier;
        return held;
    }
    if (held != was) {
        held = stage == to->at[rotor] && held == FREE ? (signed char)(was * AT_SPEED) : held;
        c->held[to->from[rotor]][rotor] = FREE;
        to->at[rotor] = NONE;
    } else if (stage == to->at[rotor]) {
        c->last.multiplier[row_of(stage, N_U + rotor)] = to->pull[rotor] / PERIOD_S;
        to->at[rotor] = NONE;
    }
    return held;
}

/* Take down how a stage's inputs are determined; whether that changed. */
static int take_down(gtmr_controller *c, int stage, const stage_bounds *within,
                     const stage_solution *found, corners *to)
{
    int changed = 0;
    for (int r = 0; r < N_U; ++r) {
        const int side = found->side[r], was = c->held[stage][r];
        signed char held = side == 0 ? FREE : side > 0 ? within->at_upper[r] : within->at_lower[r];
        double *by_input = &c->last.multiplier[row_of(stage, r)];
        double *by_speed = &c->last.multiplier[row_of(stage, N_U + r)];
        *by_input = *by_speed = 0.0;
        held = on_the_way(c, stage, r, held, found->multiplier[r], to);
        if (to->at[r] == NONE && swaps_again(c, stage, r, held) &&
            gtmr_lead_to_corner(c, stage, r, held > 0 ? 1 : -1)) {
            held = held > 0 ? AT_INPUT : -AT_INPUT;
            changed = 1;
        }
        if (is_at_speed(held)) {
            *by_speed = found->multiplier[r] / PERIOD_S;
        } else if (is_at_input(held)) {
            *by_input = found->multiplier[r];
        }
        changed |= held != was;
        c->held[stage][r] = held;
    }
    return changed;
}

/* Go forward; returns the last stage at which what is held changed. */
static int forward(gtmr_controller *c, const double *dx0, double forces[STAGES][N_U])
{
    int last_change = NONE;
    corners to;
    for (int r = 0; r < N_U; ++r) {
        to.at[r] = NONE;
        to.pull[r] = 0.0;
    }
    memset(c->step, 0, sizeof c->step);
    memcpy(c->step[0], dx0, N_X * sizeof(double));
    for (int i = 0; i < STAGES; ++i) {
        const input_cost *cost = &c->input_costs[i];
        double *now = c->step[i];
        const stage_bounds within = gtmr_bounds_of(c, i, now);
        stage_solution found = {.side = {0}};
        gtmr_law_input(law_of(c, i), now, c->v + i * N_U, found.du);
        if (i >= c->held_stages) {
            cut(&within, &found);
        } else if (holds_any(c, i) || !keeps(&within, found.du)) {
            double g[N_U];
            for (int r = 0; r < N_U; ++r) {
                const int was = c->held[i][r];
                g[r] = cost->q[r] + forces[i][r] + dot(cost->Q[r], now, LD_X);
                g[r] += to.at[r] != NONE ? to.pull[r] : 0.0;
                found.side[r] = was == FREE ? 0 : was > 0 ? 1 : -1;
            }
            if (!gtmr_solve_stage(cost, g, &within, &found)) {
                last_change = i;
            }
        }
        if (take_down(c, i, &within, &found, &to)) {
            last_change = i;
        }
        memcpy(now + N_X, found.du, sizeof found.du);
        gtmr_advance(&c->intervals[i], now, c->step[i + 1]);
    }
    return last_change;
}

/* Clearances that no free input changes have the multiplier that their slack asks for. */
static void settle_out_of_reach(gtmr_controller *c)
{
    for (int i = 0; i < STAGES; ++i) {
        const int row = row_of(i, CLEARANCE);
        if (c->counts[i] && c->inverse_norm[row] == 0.0 && c->value[row] > 0.0) {
            c->last.multiplier[row] =
                c->parameters.slack_l1 + 2.0 * c->parameters.slack_l2 * c->value[row];
        }
    }
}

/*
 * Solve the clearances with what is held; v becomes that of their multipliers, which are kept.
 * Returns 0 if that fails.
 */
static int solve_clearances(gtmr_controller *c, const double *dx0, double forces[STAGES][N_U])
{
    int any = 0;
    for (int i = 0; i < STAGES; ++i) {
        const int row = row_of(i, CLEARANCE);
        any |= c->counts[i];
        if (c->guesses > 1) {
            c->multiplier[row] = c->last.multiplier[row];
        }
        c->last.multiplier[row] = 0.0;
    }
    memset(c->v, 0, sizeof c->v);
    if (any) {
        gtmr_condense_clearances(c, dx0);
        if (gtmr_active_set_solve(c) != 0) {
            return 0;
        }
        settle_out_of_reach(c);
    }
    gtmr_clearance_forces(c, forces);
    return 1;
}

/*
 * Of what changed since a guess, let only the first input change: two that change together may each
 * be what the other changes for, and go round in a circle. Returns its stage.
 */
static int change_one(gtmr_controller *c, guess last)
{
    int stage = NONE, rotor = 0;
    for (int i = STAGES - 1; i >= 0; --i) {
        for (int r = N_U - 1; r >= 0; --r) {
            const int now = c->held[i][r], was = last[i][r];
            /* The inputs on the way to a corner belong together. */
            if (now != was && (leads(now) || leads(was))) {
                return STAGES - 1;
            }
            if (now != was) {
                stage = i;
                rotor = r;
            }
        }
    }
    const signed char changed = c->held[stage][rotor];
    memcpy(c->held, last, sizeof c->held);
    c->held[stage][rotor] = changed;
    return stage;
}

int gtmr_pivot(gtmr_controller *c, const double *dx0)
{
    double forces[STAGES][N_U], along[STAGES + 1];
    guess last = {{0}}, before = {{0}};
    int last_change = gtmr_first_guess(c);
    for (c->guesses = 1; c->guesses <= GTMR_MAX_GUESSES; ++c->guesses) {
        if (last_change != NONE) {
            gtmr_hold(c);
            gtmr_riccati_factorise_held(c, last_change);
        }
        if (!solve_clearances(c, dx0, forces)) {
            return 0;
        }
        memcpy(before, last, sizeof last);
        memcpy(last, c->held, sizeof last);
        last_change = forward(c, dx0, forces);
        gtmr_clearances_along_step(c, along);
        const int more = gtmr_count_broken(c, along);
        if (last_change == NONE && !more) {
            return 1;
        }
        if (last_change != NONE && c->guesses > 1 && memcmp(c->held, before, sizeof before) == 0) {
            last_change = change_one(c, last);
        }
    }
    return 0;
}
