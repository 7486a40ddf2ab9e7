// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/*
 * How the margins alpha_p of eq. (12) change with the plan: along one step, by second derivatives of
 * F along it; or by the gradients of all of them, from second-order adjoints.
 */
#include <string.h>

#include "combine.h"
#include "workspace.h"

/* Pi s: how the state moves when zeta goes to its worst vertex. */
static void worst_direction(const gtmr_controller *c, int stage, const double *signs,
                            double *direction)
{
    for (int r = 0; r < BODY; ++r) {
        direction[r] = 0.0;
        for (int j = 0; j < N_ZETA; ++j) {
            direction[r] += c->Pi[stage][r][j] * signs[j];
        }
    }
}

/* d(J_yx direction)/dx: the clearance's gradient turns as the vehicle goes around the tower. */
static void curvature(const double *x, const double *direction, double *of)
{
    double at[2 * CLEARANCE_LENGTH];
    memcpy(at, x, CLEARANCE_LENGTH * sizeof(double));
    memcpy(at + CLEARANCE_LENGTH, direction, CLEARANCE_LENGTH * sizeof(double));
    gtmr_model_curvature(at, of);
}

static void put(vec *lanes, int which, const double *from, int count)
{
    for (int j = 0; j < count; ++j) {
        ((double *)(lanes + j))[which] = from[j];
    }
}

static void get(const vec *lanes, int which, double *to, int count)
{
    for (int j = 0; j < count; ++j) {
        to[j] = ((const double *)(lanes + j))[which];
    }
}

static int have_same_signs(const gtmr_controller *c, int stage, int other)
{
    const double *signs = c->clearances[stage].signs;
    return memcmp(signs, c->clearances[other].signs, N_ZETA * sizeof *signs) == 0;
}

/* Stages whose margins have the same signs: the first, and the last, of them. */
typedef struct {
    int first;
    int last;
} alike;

/* Second derivative of F at a stage along Pi s and the step, lane by lane. */
typedef double bending[BODY];

static void bend(gtmr_controller *c, bending *to, int count)
{
    gtmr_model_bending(c->lanes_in, c->lanes_out);
    for (int which = 0; which < count; ++which) {
        get(c->lanes_out, which, to[which], BODY);
    }
}

/* Those of all stages before the last ones, one group after the other. */
static void bend_all(gtmr_controller *c, const alike *groups, int count, bending *to)
{
    int filled = 0;
    for (int i = 0; i < count; ++i) {
        const double *signs = c->clearances[groups[i].first].signs;
        for (int k = 0; k < groups[i].last; ++k) {
            double direction[BODY];
            vec *in = c->lanes_in;
            worst_direction(c, k, signs, direction);
            put(in, filled, c->x[k], N_X);
            put(in += N_X, filled, c->u[k], N_U);
            put(in += N_U, filled, direction, BODY);
            put(in += BODY, filled, signs, N_ZETA);
            put(in + N_ZETA, filled, c->step[k], N_XU);
            if (++filled == VEC) {
                bend(c, to, filled);
                to += filled;
                filled = 0;
            }
        }
    }
    bend(c, to, filled);
}

/* Change of J_yx Pi s along the step, for those stages of a group that are alike. */
static void change_of_alike(const gtmr_controller *c, alike group, bending *at,
                            double *change)
{
    const double *signs = c->clearances[group.first].signs;
    double turned[LD_XU] = {0.0};
    for (int i = 1; i <= group.last; ++i) {
        const clearance *y = &c->clearances[i];
        double next[LD_XU] = {0.0}, direction[BODY], turn[CLEARANCE_STATES];
        for (int r = 0; r < BODY; ++r) {
            next[r] = at[i - 1][r] + dot(c->intervals[i - 1].jacobian[r], turned, LD_XU);
        }
        memcpy(turned, next, sizeof turned);
        if (have_same_signs(c, i, group.first)) {
            worst_direction(c, i, signs, direction);
            curvature(c->x[i], direction, turn);
            change[i] = 0.0;
            for (int k = 0; k < CLEARANCE_STATES; ++k) {
                const int state = CLEARANCE_STATE[k];
                change[i] += y->gradient[k] * turned[state] + turn[k] * c->step[i][state];
            }
        }
    }
}

/* The stages from 1 to N in groups that are alike; returns how many. */
static int group_by_signs(const gtmr_controller *c, alike *groups)
{
    int count = 0;
    for (int i = 1; i <= STAGES; ++i) {
        int which = 0;
        while (which < count && !have_same_signs(c, i, groups[which].first)) {
            ++which;
        }
        if (which == count) {
            groups[count++].first = i;
        }
        groups[which].last = i;
    }
    return count;
}

static void change_by_bending(gtmr_controller *c, double *change)
{
    alike groups[STAGES];
    bending along[STAGES * (STAGES + 1) / 2], *at = along;
    const int count = group_by_signs(c, groups);
    bend_all(c, groups, count, along);
    for (int i = 0; i < count; at += groups[i].last, ++i) {
        change_of_alike(c, groups[i], at, change);
    }
}

/* The same by gradients, where they are known. */
static void change_by_gradients(const gtmr_controller *c, double *change)
{
    for (int i = 1; i <= STAGES; ++i) {
        const double(*gradient)[LD_XU] = gtmr_margin_gradient(c, i);
        change[i] = dot(gradient[i], c->step[i], LD_X);
        for (int k = 0; k < i; ++k) {
            change[i] += dot(gradient[k], c->step[k], LD_XU);
        }
    }
}

void gtmr_margin_change_along_step(gtmr_controller *c, double *change)
{
    if (c->has_margin_gradients) {
        change_by_gradients(c, change);
    } else {
        change_by_bending(c, change);
    }
}

/* What is in a lane of the adjoint: an interval on the way to a stage. */
typedef struct {
    int stage;
    int interval;
} way;

static double (*gradient_of(gtmr_controller *c, int stage))[LD_XU]
{
    return c->margin_gradient + stage * (stage + 1) / 2;
}

const double (*gtmr_margin_gradient(const gtmr_controller *c, int stage))[LD_XU]
{
    return c->margin_gradient + stage * (stage + 1) / 2;
}

static void find_gradients_on(gtmr_controller *c, const way *lanes, int count)
{
    gtmr_model_adjoint(c->lanes_in, c->lanes_out);
    for (int which = 0; which < count; ++which) {
        get(c->lanes_out, which, gradient_of(c, lanes[which].stage)[lanes[which].interval], N_XU);
    }
}

/* By its own state: the clearance's gradient turns. */
static void find_gradient_at(gtmr_controller *c, int stage)
{
    double direction[BODY], turn[CLEARANCE_STATES], *to = gradient_of(c, stage)[stage];
    memset(to, 0, LD_XU * sizeof(double));
    worst_direction(c, stage, c->clearances[stage].signs, direction);
    curvature(c->x[stage], direction, turn);
    for (int k = 0; k < CLEARANCE_STATES; ++k) {
        to[CLEARANCE_STATE[k]] = turn[k];
    }
}

/* By one sweep backwards, which carries J_yx of every stage back to the end of each interval. */
void gtmr_find_margin_gradients(gtmr_controller *c)
{
    static const double zeros[LD_BODY] = {0.0};
    double costate[STAGES + 1][LD_BODY], earlier[STAGES + 1][LD_BODY], direction[BODY];
    way lanes[VEC];
    int filled = 0;
    if (c->has_margin_gradients) {
        return;
    }
    for (int k = STAGES - 1; k >= 0; --k) {
        memset(costate[k + 1], 0, sizeof costate[k + 1]);
        for (int j = 0; j < CLEARANCE_STATES; ++j) {
            costate[k + 1][CLEARANCE_STATE[j]] = c->clearances[k + 1].gradient[j];
        }
        for (int i = k + 1; i <= STAGES; ++i) {
            const double *signs = c->clearances[i].signs;
            if (i == k + 1 || !have_same_signs(c, i, i - 1)) {
                worst_direction(c, k, signs, direction);
            }
            vec *in = c->lanes_in;
            put(in, filled, c->x[k], N_X);
            put(in += N_X, filled, c->u[k], N_U);
            put(in += N_U, filled, costate[i], BODY);
            put(in += BODY, filled, direction, BODY);
            put(in + BODY, filled, signs, N_ZETA);
            lanes[filled++] = (way){i, k};
            if (filled == VEC) {
                find_gradients_on(c, lanes, filled);
                filled = 0;
            }
        }
        find_gradient_at(c, k + 1);
        const coefficients later = {costate[k + 1], LD_BODY, 1};
        const beginning none = {zeros, 0, 1.0};
        combine_from(STAGES - k, LD_BODY, BODY, later, c->intervals[k].jacobian[0], LD_XU, none,
                     earlier[k + 1], LD_BODY);
        memcpy(costate[k + 1], earlier[k + 1], (STAGES - k) * sizeof costate[0]);
    }
    find_gradients_on(c, lanes, filled);
    c->has_margin_gradients = 1;
}
