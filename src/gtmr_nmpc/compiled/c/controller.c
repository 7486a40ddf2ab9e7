// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* The two phases of a step, and the warm start between steps. */
#include <string.h>

#include "combine.h"
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
    memset(c->has_margin_gradient, 0, sizeof c->has_margin_gradient);
    gtmr_linearise(c, t);
    gtmr_clearance_along_iterate(c);
    gtmr_riccati_factorise(c);
}

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

/* Values of all inequalities after the step of v = 0, and their bounds; which kinds are broken. */
static int inequalities(gtmr_controller *c, const double *x)
{
    double along[STAGES + 1];
    int rotors = 0, clearances = 0;
    gtmr_clearances_along_step(c, along);
    for (int i = 0; i < STAGES; ++i) {
        for (int r = 0; r < N_U; ++r) {
            const int input = row_of(i, r), speed = row_of(i, N_U + r);
            bound_rotor(c, i, r, x[BODY + r]);
            c->value[input] = c->u[i][r] + c->step[i][N_X + r];
            c->value[speed] = c->x[i + 1][BODY + r] + c->step[i + 1][BODY + r];
            rotors |= outside(c, input, INPUT_ROUNDING) | outside(c, speed, SPEED_ROUNDING);
        }
        const int row = row_of(i, CLEARANCE);
        c->lower[row] = -HUGE_VAL;
        c->upper[row] = 0.0;
        c->value[row] = along[i + 1];
        clearances |= outside(c, row, CLEARANCE_ROUNDING);
    }
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

static double planned_slack(const gtmr_controller *c, int row)
{
    const double slack = c->value[row] + dot(c->rows[row], c->v, row_length(row));
    return slack > SLACK_ROUNDING ? slack : 0.0;
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
    gtmr_condense_clearances(c);
    if (gtmr_active_set_solve(c) != 0) {
        return 0;
    }
    gtmr_rollout(c, dx0, c->v);
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
    gtmr_condense(c);
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
    int by_rows = simple && clearances_suffice(c, dx0);
    if (!by_rows && !guesses_suffice(c, dx0)) {
        by_rows = 1;
        if (solve_whole(c, x, dx0) != 0) {
            /* A dual method has no feasible point before its end: cut the inputs of what it has. */
            gtmr_rollout_within(c, dx0, c->v);
            slack_of_step(c, slack);
            return GTMR_LIMITED;
        }
    }
    if (!by_rows) {
        slack_of_step(c, slack);
    }
    for (int i = 0; i < STAGES; ++i) {
        slack[i + 1] = by_rows ? planned_slack(c, row_of(i, CLEARANCE)) : slack[i + 1];
        status = slack[i + 1] > 0.0 ? GTMR_SOFTENED : status;
    }
    return status;
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

int gtmr_guesses(const gtmr_controller *c)
{
    return c->guesses;
}

int gtmr_passes(const gtmr_controller *c)
{
    return c->passes;
}
