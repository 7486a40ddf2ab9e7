// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/*
 * Dual active-set method (Goldfarb and Idnani) for |v|^2 / 2 with rows between bounds.
 *
 * v = -sum lambda_j a_j over the working set, whose Gram matrix is kept as a Cholesky factor. The
 * dual objective never falls, so that any multipliers >= 0, such as the last step's, are a start.
 * The exact penalty l1 s + l2 s^2 caps a multiplier softly: up to l1 the row is hard, above it
 * the row gives way by s = (lambda - l1) / (2 l2), which adds to the Gram matrix's diagonal.
 */
#include <string.h>

#include "combine.h"
#include "workspace.h"

/* Share of the largest violation from which on the worst of other rows enters together with it. */
#define TOGETHER 0.2

/*
 * Passes that a step may take: a change of the multipliers up to the row that stops it, or the
 * entry of violated rows. No solution of 10^6 hard random QPs takes more than 334, all but one in
 * 10^5 at most 273, see docs/solver.md; rows and with them passes grow with horizon and rotors.
 */
#ifndef GTMR_MAX_PASSES
#define GTMR_MAX_PASSES (8 * N_V)
#endif

enum { REFINEMENTS = 2, WARM_ROUNDS = 5, NONE = -1, ITSELF = -2 };

/* Begin a pass; 0 if the step has had all that it may have. */
static int another_pass(gtmr_controller *c)
{
    if (c->passes == GTMR_MAX_PASSES) {
        return 0;
    }
    ++c->passes;
    return 1;
}

static active_row row_at_bound(const gtmr_controller *c, int row, double side)
{
    const double scale = c->inverse_norm[row];
    const int softened = row % STAGE_ROWS == CLEARANCE;
    const active_row at = {
        .row = row,
        .side = side,
        .scale = scale,
        .cap = softened ? c->parameters.slack_l1 / scale : HUGE_VAL,
    };
    return at;
}

/* How far a multiplier can go along a direction until it reaches 0 or its cap. */
static double room(const active_row *a, double direction)
{
    if (direction < 0.0) {
        const double step = ((a->soft ? a->cap : 0.0) - a->lambda) / direction;
        return step > 0.0 ? step : 0.0;
    }
    if (direction > 0.0 && !a->soft) {
        return (a->cap - a->lambda) / direction;
    }
    return HUGE_VAL;
}

/* How far all multipliers can go, `limit` at most, and which one stops them. */
static double longest_step(const working_set *set, const double *direction, double limit,
                           int *blocking)
{
    double longest = limit;
    for (int i = 0; i < set->count; ++i) {
        const double step = room(&set->member[i], direction[i]);
        if (step < longest) {
            longest = step;
            *blocking = i;
        }
    }
    return longest;
}

static void add_to_multipliers(working_set *set, const double *direction, double step)
{
    for (int i = 0; i < set->count; ++i) {
        set->member[i].lambda += step * direction[i];
    }
}

/* By how much a row exceeds its bound where v = 0, scaled. */
static double excess_at_zero(const gtmr_controller *c, const active_row *a)
{
    const double bound = a->side > 0.0 ? c->upper[a->row] : c->lower[a->row];
    return a->side * a->scale * (c->value[a->row] - bound);
}

/* v of the multipliers. */
static void minimiser(gtmr_controller *c)
{
    double by[LD_ACTIVE];
    for (int i = 0; i < c->active.count; ++i) {
        by[i] = -c->active.member[i].lambda;
    }
    memset(c->v, 0, sizeof c->v);
    gtmr_working_set_combine(c, by, c->v);
}

/*
 * By how much each row of the set exceeds its bound, less what its slack takes up: the gradient of
 * the dual objective.
 */
static void measure_excess(gtmr_controller *c)
{
    double change[LD_ACTIVE];
    minimiser(c);
    gtmr_working_set_along(c, c->v, LD_V, change);
    c->active.settled = 0;
    for (int i = 0; i < c->active.count; ++i) {
        active_row *a = &c->active.member[i];
        const double slack = a->soft ? gtmr_compliance(c, a) * (a->lambda - a->cap) : 0.0;
        a->excess = excess_at_zero(c, a) + change[i] - slack;
    }
}

/* Change of the multipliers to where all rows of the set hold with equality. */
static void correction(const working_set *set, double *change)
{
    memset(change, 0, set->settled * sizeof(double));
    for (int i = set->settled; i < set->count; ++i) {
        change[i] = set->member[i].excess;
    }
    gtmr_working_set_forward(set, change);
    gtmr_working_set_backward(set, change);
}

/* Go a part of a correction; rows that are settled stay so. */
static void advance(working_set *set, const double *change, double step)
{
    add_to_multipliers(set, change, step);
    for (int i = set->settled; i < set->count; ++i) {
        set->member[i].excess *= 1.0 - step;
    }
    if (step == 1.0) {
        set->settled = set->count;
    }
}

/*
 * Change of the set's multipliers, per unit of that of a dependent row, that leaves v alone; w as
 * from `gtmr_working_set_append`. Returns the sign of the change that raises the dual objective.
 */
static double null_direction(const gtmr_controller *c, const active_row *row, double *w)
{
    const working_set *set = &c->active;
    double slope = excess_at_zero(c, row);
    gtmr_working_set_backward(set, w);
    for (int i = 0; i < set->count; ++i) {
        /* A soft row is independent of all others. */
        w[i] = set->member[i].soft ? 0.0 : -w[i];
        slope += w[i] * excess_at_zero(c, &set->member[i]);
    }
    return slope < 0.0 ? -1.0 : 1.0;
}

/*
 * Let a row enter; while it depends on others, multipliers go along the null direction until one
 * of them makes way. Returns 0 if none does, as the hard rows contradict each other, or if there
 * is no pass left to go on.
 */
static int enter(gtmr_controller *c, active_row row)
{
    working_set *set = &c->active;
    double direction[LD_ACTIVE], w[LD_ACTIVE];
    while (!gtmr_working_set_append(c, &row, direction)) {
        if (!another_pass(c)) {
            return 0;
        }
        int blocking = ITSELF;
        const double sign = null_direction(c, &row, direction);
        for (int i = 0; i < set->count; ++i) {
            direction[i] *= sign;
        }
        const double step = longest_step(set, direction, room(&row, sign), &blocking);
        if (step == HUGE_VAL) {
            return 0;
        }
        add_to_multipliers(set, direction, step);
        row.lambda += sign * step;
        if (blocking == ITSELF) {
            if (sign < 0.0) {
                return 1;
            }
            row.soft = 1;
            row.lambda = row.cap;
        } else {
            const int leaves = direction[blocking] < 0.0;
            active_row other = gtmr_working_set_remove(c, blocking);
            other.soft = 1;
            other.lambda = other.cap;
            if (!leaves && !gtmr_working_set_append(c, &other, w)) {
                return 0;
            }
        }
    }
    return 1;
}

/* Let go of a row whose multiplier reached 0, or change sides at the cap. */
static int pass_limit(gtmr_controller *c, int blocking, double direction)
{
    active_row row = gtmr_working_set_remove(c, blocking);
    if (direction < 0.0 && !row.soft) {
        return 1;
    }
    row.lambda = row.cap;
    row.soft = !row.soft;
    return enter(c, row);
}

/*
 * Let go of all rows without a multiplier that would need one below 0; returns how many. v stays
 * as it is, and of the rows that have just entered at least one stays, as together they ascend.
 */
static int drop_idle(gtmr_controller *c, const double *direction)
{
    int dropped = 0;
    for (int i = c->active.count - 1; i >= 0; --i) {
        if (c->active.member[i].lambda == 0.0 && direction[i] < 0.0) {
            gtmr_working_set_remove(c, i);
            ++dropped;
        }
    }
    return dropped;
}

/* Iterative refinement, as the Gram matrix squares the condition of the rows. */
static void refine(gtmr_controller *c)
{
    double change[LD_ACTIVE];
    for (int pass = 0; pass < REFINEMENTS; ++pass) {
        measure_excess(c);
        correction(&c->active, change);
        advance(&c->active, change, 1.0);
    }
    minimiser(c);
}

static active_row violated_row(const gtmr_controller *c, int row, double violation)
{
    active_row a = row_at_bound(c, row, violation > 0.0 ? 1.0 : -1.0);
    a.excess = fabs(violation);
    return a;
}

/*
 * Let the worst row enter, and with it the worst of each rotor and of the clearances: of different
 * rotors one hardly changes what the other needs.
 */
static int enter_violated(gtmr_controller *c, const double *violation, int worst)
{
    double w[LD_ACTIVE], most[N_U + 1] = {0.0};
    int of[N_U + 1] = {0};
    if (!enter(c, violated_row(c, worst, violation[worst]))) {
        return 0;
    }
    for (int i = first_row(c); i < N_ROWS; i += row_stride(c)) {
        const int which = i % STAGE_ROWS;
        const int group = which == CLEARANCE ? N_U : which % N_U;
        if (fabs(violation[i]) > most[group]) {
            most[group] = fabs(violation[i]);
            of[group] = i;
        }
    }
    for (int group = 0; group <= N_U; ++group) {
        const int row = of[group];
        if (most[group] > TOGETHER * fabs(violation[worst]) && !c->in_set[row]) {
            const active_row enters = violated_row(c, row, violation[row]);
            gtmr_working_set_append(c, &enters, w);
        }
    }
    return 1;
}

/* Take up the multipliers of the last QP. */
static void take_up(gtmr_controller *c)
{
    double w[LD_ACTIVE];
    c->active.count = c->active.settled = 0;
    memset(c->in_set, 0, sizeof c->in_set);
    for (int i = first_row(c); i < N_ROWS; i += row_stride(c)) {
        const double multiplier = c->multiplier[i];
        const double bound = multiplier > 0.0 ? c->upper[i] : c->lower[i];
        if (multiplier == 0.0 || fabs(bound) == HUGE_VAL || c->inverse_norm[i] == 0.0) {
            continue;
        }
        active_row row = row_at_bound(c, i, multiplier > 0.0 ? 1.0 : -1.0);
        row.lambda = fabs(multiplier) / row.scale;
        row.soft = row.lambda > row.cap;
        gtmr_working_set_append(c, &row, w);
    }
}

/*
 * Go to where the rows of the set hold with equality; true if they do, with multipliers that may
 * be. Rows that would need one below 0 go. Those beyond their cap, or soft and below it, change
 * sides all at once: one at a time, each at the cap, they may send each other back for long.
 */
static int settle(gtmr_controller *c)
{
    working_set *set = &c->active;
    double direction[LD_ACTIVE];
    int settled = 1, changes_sides = 0;
    measure_excess(c);
    correction(set, direction);
    for (int i = set->count - 1; i >= 0; --i) {
        active_row *a = &set->member[i];
        const double lambda = a->lambda + direction[i];
        a->lambda = lambda > 0.0 ? lambda : 0.0;
        c->multiplier[a->row] = a->side * a->scale * a->lambda;
        settled = settled && a->lambda == lambda;
        changes_sides = changes_sides || (lambda > a->cap) != a->soft;
        if (lambda < 0.0) {
            gtmr_working_set_remove(c, i);
        }
    }
    if (changes_sides) {
        take_up(c);
    }
    return settled && !changes_sides;
}

/*
 * Begin with the working set of the last QP, less what does not belong in it any more. Here all
 * rows that would need a multiplier below 0 go at once: it is only a start.
 */
static void warm_start(gtmr_controller *c)
{
    take_up(c);
    for (int round = 0; round < WARM_ROUNDS; ++round) {
        if (settle(c)) {
            c->active.settled = c->active.count;
            return;
        }
    }
    measure_excess(c);
}

static void keep_multipliers(gtmr_controller *c)
{
    for (int i = 0; i < c->active.count; ++i) {
        const active_row *a = &c->active.member[i];
        c->last.multiplier[a->row] = a->side * a->scale * a->lambda;
    }
}

/* Go on until all rows hold; 0 if that does not come about. */
static int iterate(gtmr_controller *c)
{
    working_set *set = &c->active;
    double change[LD_ACTIVE], violation[N_ROWS];
    while (another_pass(c)) {
        if (set->settled < set->count) {
            int blocking = NONE;
            correction(set, change);
            if (drop_idle(c, change)) {
                continue;
            }
            advance(set, change, longest_step(set, change, 1.0, &blocking));
            if (blocking != NONE) {
                if (!pass_limit(c, blocking, change[blocking])) {
                    return 0;
                }
                continue;
            }
        }
        minimiser(c);
        int worst = gtmr_violations(c, violation);
        if (worst == NONE) {
            refine(c);
            worst = gtmr_violations(c, violation);
        }
        if (worst == NONE) {
            return 1;
        }
        if (!enter_violated(c, violation, worst)) {
            return 0;
        }
    }
    return 0;
}

int gtmr_active_set_solve(gtmr_controller *c)
{
    warm_start(c);
    const int solved = iterate(c);
    if (!solved) {
        minimiser(c);
    }
    /* Of a contradiction no multiplier is a start. */
    if (solved || c->passes == GTMR_MAX_PASSES) {
        keep_multipliers(c);
    }
    return !solved;
}
