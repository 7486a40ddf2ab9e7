// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* The second phase of a step: the QP with its inequalities, once the state is known. */
#include <string.h>

#include "workspace.h"

/* Violations below these are rounding: of an input [Hz/s], a speed [Hz], the clearance [m]. */
#define INPUT_ROUNDING 1e-9
#define SPEED_ROUNDING 1e-10
#define CLEARANCE_ROUNDING 1e-14
/* Slack below this is rounding as well [m]. */
#define SLACK_ROUNDING 1e-9
/* By how much a solution may break the limits of rotors. */
#define LIMIT_TOLERANCE_HZ_S 1e-6
#define LIMIT_TOLERANCE_HZ 1e-6

/* Bounds of a rotor's input and next speed; `start` is its measured speed. */
static void bound_rotor(gtmr_controller *c, int stage, int rotor, double start)
{
    const gtmr_parameters *given = &c->parameters;
    const int input = row_of(stage, rotor), speed = row_of(stage, N_U + rotor);
    const double limit = given->max_rotor_acceleration_hz_s;
    const double reach = limit * PERIOD_S * (stage + 1);
    c->lower[input] = -limit;
    c->upper[input] = limit;
    c->lower[speed] = given->min_rotor_speed_hz;
    c->upper[speed] = given->max_rotor_speed_hz;
    /* A rotor that starts outside its limits returns as fast as it can: all that its speed bound,
     * relaxed to what is reachable, would leave. */
    if (start + reach <= given->min_rotor_speed_hz) {
        c->lower[input] = limit;
        c->lower[speed] = -HUGE_VAL;
    }
    if (start - reach >= given->max_rotor_speed_hz) {
        c->upper[input] = -limit;
        c->upper[speed] = HUGE_VAL;
    }
}

static int outside(const gtmr_controller *c, int row, double tolerance)
{
    /* Written so that a value that is no number counts as outside. */
    return !(c->value[row] <= c->upper[row] + tolerance &&
             c->value[row] >= c->lower[row] - tolerance);
}

enum { ROTORS_BROKEN = 1, CLEARANCES_BROKEN = 2 };

/* The tightened clearances of stages 1 to N after a step [m]. */
void gtmr_clearances_along_step(gtmr_controller *c, double *along)
{
    double change[STAGES + 1] = {0.0};
    if (with_margin_gradient(c)) {
        gtmr_margin_change_along_step(c, change);
    }
    for (int i = 1; i <= STAGES; ++i) {
        const clearance *y = &c->clearances[i];
        const double *dp = c->step[i];
        along[i] = y->residual + y->gradient[0] * dp[0] + y->gradient[1] * dp[1] + change[i];
    }
}

int gtmr_count_broken(gtmr_controller *c, const double *along)
{
    int more = 0;
    for (int i = 0; i < STAGES; ++i) {
        const int broken = !(along[i + 1] <= CLEARANCE_ROUNDING);
        more |= broken & !c->counts[i];
        c->counts[i] |= broken;
    }
    return more;
}

/* Values of all inequalities after the step of v = 0, and their bounds; which kinds are broken. */
static int inequalities(gtmr_controller *c, const double *x)
{
    double along[STAGES + 1];
    int rotors = 0, clearances = 0;
    for (int i = 0; i < STAGES; ++i) {
        for (int r = 0; r < N_U; ++r) {
            const int input = row_of(i, r), speed = row_of(i, N_U + r);
            bound_rotor(c, i, r, x[BODY + r]);
            c->value[input] = c->u[i][r] + c->step[i][N_X + r];
            c->value[speed] = c->x[i + 1][BODY + r] + c->step[i + 1][BODY + r];
            rotors |= outside(c, input, INPUT_ROUNDING) | outside(c, speed, SPEED_ROUNDING);
        }
    }
    if (rotors && with_margin_gradient(c)) {
        /* Margins will be asked for along many steps. */
        gtmr_find_margin_gradients(c);
    }
    gtmr_clearances_along_step(c, along);
    for (int i = 0; i < STAGES; ++i) {
        const int row = row_of(i, CLEARANCE);
        c->lower[row] = -HUGE_VAL;
        c->upper[row] = 0.0;
        c->value[row] = along[i + 1];
        c->counts[i] = c->multiplier[row] != 0.0;
        clearances |= !(along[i + 1] <= CLEARANCE_ROUNDING);
    }
    gtmr_count_broken(c, along);
    return (rotors ? ROTORS_BROKEN : 0) | (clearances ? CLEARANCES_BROKEN : 0);
}

/* Stage 0 is measured, not planned: its violation is a fact and no variable of the QP. */
static double measured_slack(const gtmr_controller *c, const double *x)
{
    const clearance *now = &c->clearances[0];
    double constraint[1 + CLEARANCE_STATES];
    gtmr_clearance_at(&c->parameters, x, constraint);
    const double residual = constraint[0] + now->alpha_p + now->alpha_g;
    return residual > 0.0 ? residual : 0.0;
}

/* alpha_p as it is told: its terms added as NumPy adds nine numbers, so that whoever adds them finds
 * the same. */
static double told_alpha_p(const gtmr_controller *c, const clearance *y)
{
    const double *a = y->by_channel;
    const double sum = ((a[0] + a[1]) + (a[2] + a[3])) + ((a[4] + a[5]) + (a[6] + a[7])) + a[8];
    return sum + c->margin_scale * c->parameters.eps_s_m;
}

static void write_plan(const gtmr_controller *c, const double *slack, double *to)
{
    double *channels = to + PLAN_X + PLAN_U, *alpha_p = channels + PLAN_CHANNELS;
    double *alpha_g = alpha_p + STAGES + 1;
    memcpy(to, c->last.x, sizeof c->last.x);
    memcpy(to + PLAN_X, c->last.u, sizeof c->last.u);
    for (int i = 0; i <= STAGES; ++i) {
        const clearance *y = &c->clearances[i];
        memcpy(channels + i * N_ZETA, y->by_channel, sizeof y->by_channel);
        alpha_p[i] = told_alpha_p(c, y);
        alpha_g[i] = y->alpha_g;
    }
    if (c->is_tightened) {
        memcpy(alpha_p, c->told, sizeof c->told);
    }
    memcpy(alpha_g + STAGES + 1, slack, (STAGES + 1) * sizeof(double));
    gtmr_setpoints(c, (double(*)[N_U])(to + PLAN_SETPOINTS));
}

static void take_step(gtmr_controller *c)
{
    for (int i = 0; i <= STAGES; ++i) {
        for (int j = 0; j < N_X; ++j) {
            c->last.x[i][j] = c->x[i][j] + c->step[i][j];
        }
        for (int j = 0; i < STAGES && j < N_U; ++j) {
            c->last.u[i][j] = c->u[i][j] + c->step[i][N_X + j];
        }
    }
}

static int is_finite_step(const gtmr_controller *c)
{
    double total = 0.0;
    for (int i = 0; i <= STAGES; ++i) {
        for (int j = 0; j < N_XU; ++j) {
            total += c->step[i][j];
        }
    }
    return isfinite(total);
}

static void stay(gtmr_controller *c)
{
    memcpy(c->last.x, c->x, sizeof c->x);
    memcpy(c->last.u, c->u, sizeof c->u);
}

/* Whether the step breaks limits of rotors by more than so many Hz/s or Hz. */
static int breaks_rotor_limits(const gtmr_controller *c, double by_hz_s, double by_hz)
{
    int broken = 0;
    for (int i = 0; i < STAGES; ++i) {
        for (int r = 0; r < N_U; ++r) {
            const int input = row_of(i, r), speed = row_of(i, N_U + r);
            const double u = c->u[i][r] + c->step[i][N_X + r];
            const double xi = c->x[i + 1][BODY + r] + c->step[i + 1][BODY + r];
            broken |= !(u <= c->upper[input] + by_hz_s &&
                        u >= c->lower[input] - by_hz_s &&
                        xi <= c->upper[speed] + by_hz &&
                        xi >= c->lower[speed] - by_hz);
        }
    }
    return broken;
}

static int starts_with_rotors(const gtmr_controller *c)
{
    for (int i = 0; i < N_ROWS; ++i) {
        if (c->multiplier[i] != 0.0 && i % STAGE_ROWS != CLEARANCE) {
            return 1;
        }
    }
    return 0;
}

/*
 * The QP with the clearances alone, which are few and most often all that binds. Its solution is
 * that of the whole QP if it keeps the limits of the rotors; whether it does.
 */
static int clearances_suffice(gtmr_controller *c, const double *dx0)
{
    double along[STAGES + 1];
    do {
        gtmr_condense_clearances(c, dx0);
        if (gtmr_active_set_solve(c) != 0) {
            return 0;
        }
        gtmr_rollout(c, dx0, c->v);
        gtmr_clearances_along_step(c, along);
    } while (gtmr_count_broken(c, along));
    return !breaks_rotor_limits(c, INPUT_ROUNDING, SPEED_ROUNDING);
}

/* By how much the step breaks the tightened clearances. */
static void slack_of_step(gtmr_controller *c, double *slack)
{
    double along[STAGES + 1];
    gtmr_clearances_along_step(c, along);
    for (int i = 1; i <= STAGES; ++i) {
        slack[i] = along[i] > SLACK_ROUNDING ? along[i] : 0.0;
    }
}

/* Begin where the guesses ended, unless that is no number. */
static void start_from_guess(gtmr_controller *c)
{
    double total = 0.0;
    for (int i = 0; i < N_ROWS; ++i) {
        total += fabs(c->last.multiplier[i]);
    }
    for (int i = 0; i < N_ROWS; ++i) {
        c->multiplier[i] = isfinite(total) ? c->last.multiplier[i] : 0.0;
    }
    memset(c->last.multiplier, 0, sizeof c->last.multiplier);
}

/* The whole QP by rows; 0 if solved. Rotor limits are hard: a step that breaks them is no
 * solution. */
static int solve_whole(gtmr_controller *c, const double *x, const double *dx0)
{
    c->passes = c->held_stages = 0;
    c->guesses = -1;
    gtmr_rollout(c, dx0, NULL);
    inequalities(c, x);
    gtmr_condense(c, dx0);
    start_from_guess(c);
    if (gtmr_active_set_solve(c) != 0) {
        return 1;
    }
    gtmr_rollout(c, dx0, c->v);
    return breaks_rotor_limits(c, LIMIT_TOLERANCE_HZ_S, LIMIT_TOLERANCE_HZ);
}

/* The whole QP by guesses; whether that solved it. */
static int guesses_suffice(gtmr_controller *c, const double *dx0)
{
    return gtmr_pivot(c, dx0) &&
           !breaks_rotor_limits(c, LIMIT_TOLERANCE_HZ_S, LIMIT_TOLERANCE_HZ);
}

/* The QP with its inequalities, of which some kinds are broken at v = 0. */
static gtmr_status constrained_step(gtmr_controller *c, const double *x, const double *dx0,
                                    int broken, double *slack)
{
    gtmr_status status = GTMR_SOLVED;
    const int simple = broken == CLEARANCES_BROKEN && !starts_with_rotors(c);
    const int limited = !(simple && clearances_suffice(c, dx0)) && !guesses_suffice(c, dx0) &&
                        solve_whole(c, x, dx0) != 0;
    if (limited) {
        /* A dual method has no feasible point before its end: cut the inputs of what it has. */
        gtmr_rollout_within(c, dx0, c->v);
    }
    slack_of_step(c, slack);
    for (int i = 1; i <= STAGES; ++i) {
        status = slack[i] > 0.0 ? GTMR_SOFTENED : status;
    }
    return limited ? GTMR_LIMITED : status;
}

gtmr_status gtmr_feedback(gtmr_controller *c, const double *x, double *to)
{
    double dx0[N_X], slack[STAGES + 1] = {0.0};
    gtmr_status status = GTMR_SOLVED;
    for (int j = 0; j < N_X; ++j) {
        dx0[j] = x[j] - c->x[0][j];
    }
    memset(c->last.multiplier, 0, sizeof c->last.multiplier);
    c->passes = c->guesses = c->held_stages = 0;
    gtmr_rollout(c, dx0, NULL);
    const int broken = inequalities(c, x);
    if (broken) {
        status = constrained_step(c, x, dx0, broken, slack);
    }
    if (!is_finite_step(c)) {
        status = GTMR_FAILED;
        memset(slack, 0, sizeof slack);
        memset(c->last.multiplier, 0, sizeof c->last.multiplier);
        stay(c);
    } else {
        take_step(c);
    }
    slack[0] = measured_slack(c, x);
    write_plan(c, slack, to);
    return status;
}
