// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

#include "gtmr_loop.h"

#include <math.h>
#include <string.h>

#define PI 3.141592653589793
#define TAU 6.283185307179586
#define N_NUMBERS 17 /* a row for a measurement */

enum { DUE_GUST = 1, DUE_WIND = 2, DUE_SAMPLE = 4 };

int64_t gtmr_loop_size(void)
{
    return sizeof(gtmr_loop);
}

static int64_t n_x(const gtmr_loop *l)
{
    return 12 + l->n_rotors;
}

static int64_t smaller(int64_t a, int64_t b)
{
    return a < b ? a : b;
}

/* Length of a vector in the plane, rounded once. */
static double length(double x, double y)
{
    double xx = x * x, yy = y * y, squared = xx + yy, part = squared - xx, rest, root;
    if (squared == 0.0)
        return 0.0;
    rest = (xx - (squared - part)) + (yy - part);
    rest += fma(x, x, -xx) + fma(y, y, -yy);
    root = sqrt(squared);
    return root + (fma(-root, root, squared) + rest) / (2.0 * root);
}

/* The next row of what is drawn ahead; NULL if there is none. */
static const double *next_row(gtmr_loop_ahead *ahead, int64_t columns)
{
    return ahead->used < ahead->count ? ahead->rows + columns * ahead->used++ : NULL;
}

static int draw_gust(gtmr_loop *l)
{
    const double *row = next_row(&l->gust, l->gust_is_inward ? 1 : 3);
    double rho;
    if (row == NULL)
        return 0;
    if (!l->gust_is_inward) {
        memcpy(l->gust_n, row, sizeof l->gust_n);
        return 1;
    }
    rho = length(l->x[0], l->x[1]);
    l->gust_n[0] = rho == 0.0 ? 0.0 : row[0] * (-l->x[0] / rho);
    l->gust_n[1] = rho == 0.0 ? 0.0 : row[0] * (-l->x[1] / rho);
    l->gust_n[2] = 0.0;
    return 1;
}

/* Share of the wind that is missing behind a tower. */
static double wake_deficit(double drag_coefficient, double x, double y)
{
    double width = pow(x * x + y * y, 0.25), deficit;
    if (x <= 0.0 || fabs(y) >= width)
        return 0.0;
    deficit = drag_coefficient / width * pow(cos(0.5 * PI * y / width), 2.0);
    return deficit < 1.0 ? deficit : 1.0;
}

/* Mean wind at the vehicle's position, for a far wind. */
static void around_tower(const gtmr_loop *l, const double *far, double *flow)
{
    double speed = length(far[0], far[1]), along[2], x, y, r, u = 1.0, v = 0.0, left = 1.0;
    memcpy(flow, far, 3 * sizeof *flow);
    if (speed == 0.0 || !(l->flow_around_tower || l->wake))
        return;
    along[0] = far[0] / speed, along[1] = far[1] / speed;
    x = fma(along[1], l->x[1], along[0] * l->x[0]) / l->tower_radius_m;
    y = fma(along[0], l->x[1], -along[1] * l->x[0]) / l->tower_radius_m;
    r = length(x, y);
    if (r < 1.0) {
        x = r > 0.0 ? x / r : -1.0;
        y = r > 0.0 ? y / r : 0.0;
        r = 1.0;
    }
    if (l->flow_around_tower) {
        double r4 = pow(r, 4.0);
        u = 1.0 - (x * x - y * y) / r4;
        v = -2.0 * x * y / r4;
    }
    if (l->wake)
        left = 1.0 - wake_deficit(l->tower_drag_coefficient, x, y);
    flow[0] = speed * left * (u * along[0] + v * -along[1]);
    flow[1] = speed * left * (u * along[1] + v * along[0]);
}

static int draw_wind(gtmr_loop *l)
{
    const double *row = NULL;
    double height = (l->x[2] > 0.0 ? l->x[2] : 0.0) / l->reference_height_m;
    double grown = l->profile_exponent > 0.0 ? pow(height, l->profile_exponent) : 1.0;
    double far[3];
    int i;
    if (l->is_turbulent && (row = next_row(&l->turbulence, 3)) == NULL)
        return 0;
    for (i = 0; i < 3; i++)
        far[i] = grown * l->far_m_s[i];
    around_tower(l, far, l->air_m_s);
    if (row != NULL) {
        l->air_m_s[0] += l->along[0] * row[0] - l->along[1] * row[1];
        l->air_m_s[1] += l->along[1] * row[0] + l->along[0] * row[1];
        l->air_m_s[2] += row[2];
    }
    return 1;
}

/* An angle from -pi up to pi. */
static double wrapped(double angle)
{
    double rest = fmod(angle + PI, TAU);
    return (rest < 0.0 ? rest + TAU : rest) - PI;
}

int64_t gtmr_loop_newest(gtmr_loop *l)
{
    int64_t i, kept = 0, n = n_x(l);
    for (i = 0; i < l->way; i++) {
        if (l->way_arrives[i] <= l->step) {
            if (l->way_made[i] > l->newest_made) {
                l->newest_made = l->way_made[i];
                memcpy(l->newest_x, l->way_x + i * n, n * sizeof *l->way_x);
            }
            continue;
        }
        if (kept < i) {
            l->way_arrives[kept] = l->way_arrives[i];
            l->way_made[kept] = l->way_made[i];
            memcpy(l->way_x + kept * n, l->way_x + i * n, n * sizeof *l->way_x);
        }
        kept++;
    }
    l->way = kept;
    return l->newest_made;
}

static int measure(gtmr_loop *l)
{
    const double *row = next_row(&l->numbers, N_NUMBERS);
    int64_t i, arrives = l->step;
    double *x;
    if (row == NULL)
        return 0;
    /* Those that have arrived make room. */
    gtmr_loop_newest(l);
    x = l->way_x + l->way * n_x(l);
    memcpy(x, l->x, n_x(l) * sizeof *x);
    for (i = 0; i < 12; i++)
        x[i] += l->noise_std[i] * row[i];
    for (i = 0; i < 3; i++) {
        x[i] += l->bias_m[i];
        x[3 + i] = wrapped(x[3 + i]);
        l->bias_m[i] = l->bias_kept * l->bias_m[i] + l->bias_spread_m * row[12 + i];
    }
    if (l->rotor_quantum_hz > 0.0)
        for (i = 12; i < n_x(l); i++)
            x[i] = l->rotor_quantum_hz * rint(x[i] / l->rotor_quantum_hz);
    /* A flight goes on from one before it: its first state is known. */
    if (l->step > 0) {
        if (row[16] < l->dropout)
            return 1;
        arrives += (int64_t)ceil((l->delay_s - row[15] * l->jitter_s) / l->step_s - 1e-6);
    }
    l->way_arrives[l->way] = arrives;
    l->way_made[l->way++] = l->step;
    return 1;
}

void gtmr_loop_draw(gtmr_loop *l)
{
    l->due |= DUE_GUST | (l->has_wind ? DUE_WIND : 0);
}

void gtmr_loop_measure(gtmr_loop *l)
{
    l->due |= DUE_SAMPLE;
}

/* Do what is due at this instant. */
static gtmr_loop_status meet(gtmr_loop *l)
{
    if (l->due & DUE_GUST && !draw_gust(l))
        return GTMR_LOOP_NEEDS_GUST;
    l->due &= ~DUE_GUST;
    if (l->due & DUE_WIND && !draw_wind(l))
        return GTMR_LOOP_NEEDS_TURBULENCE;
    l->due &= ~DUE_WIND;
    if (l->due & DUE_SAMPLE && !measure(l))
        return GTMR_LOOP_NEEDS_NUMBERS;
    l->due = 0;
    return GTMR_LOOP_DONE;
}

/* Play the plan whose time has come. */
static void take_over(gtmr_loop *l)
{
    while (l->coming > 0 && l->plans[1].acts <= l->step) {
        gtmr_loop_plan over = l->plans[0];
        memmove(l->plans, l->plans + 1, l->coming * sizeof *l->plans);
        /* Its rows are used again. */
        l->plans[l->coming--] = over;
    }
}

int gtmr_loop_play(gtmr_loop *l, int64_t start, int64_t acts, gtmr_loop_kind kind, int64_t n,
                   const double *u, const double *setpoints_hz)
{
    int64_t kept = 0;
    gtmr_loop_plan *plan;
    while (kept < l->coming && l->plans[1 + kept].acts < acts)
        kept++;
    if (2 + kept > l->plans_room || n > l->plan_rows_room)
        return 0;
    plan = l->plans + 1 + kept;
    plan->acts = acts, plan->start = start, plan->kind = kind, plan->n = n;
    plan->has_setpoints = setpoints_hz != NULL;
    if (n > 0)
        memcpy(plan->u, u, n * l->n_rotors * sizeof *u);
    if (setpoints_hz != NULL)
        memcpy(plan->setpoints_hz, setpoints_hz, (n + 1) * l->n_rotors * sizeof *setpoints_hz);
    l->coming = kept + 1;
    take_over(l);
    return 1;
}

/* Give the guard the newest measured state, if one has arrived that it has not seen. */
static void look(gtmr_loop *l)
{
    int64_t i, made = l->has_sensor ? gtmr_loop_newest(l) : l->step;
    if (made <= l->seen) {
        for (i = 0; i < n_x(l); i++)
            l->guard_sight[i] = NAN;
        return;
    }
    l->seen = made;
    memcpy(l->guard_sight, l->has_sensor ? l->newest_x : l->x, 12 * sizeof *l->x);
    /* It sits at the actuators, whose speeds it reads at once. */
    memcpy(l->guard_sight + 12, l->x + 12, l->n_rotors * sizeof *l->x);
}

/* Step the guard if it is time, which may take the place of u; gives when the next step is. */
static int64_t guarded(gtmr_loop *l, double *u)
{
    const gtmr_loop_plan *plan = l->plans;
    int64_t i, period = l->cause ? l->act : l->watch;
    if (l->step % period == 0) {
        int64_t age = l->step - plan->start;
        double overdue_s = (age - plan->n * l->plan_step) * l->step_s;
        double dt_s = (l->step - l->looked) * l->step_s;
        for (i = 0; i < l->n_rotors; i++)
            l->guard_due[i] = plan->kind == GTMR_LOOP_UNUSABLE ? NAN : u[i];
        l->looked = l->step;
        look(l);
        l->cause = l->guard(l->guard_memory, dt_s, l->guard_sight, l->guard_sight + 3,
                            l->guard_sight + 12, l->guard_due, overdue_s, age * l->step_s,
                            l->guard_u);
        period = l->cause ? l->act : l->watch;
    }
    if (l->cause)
        memcpy(u, l->guard_u, l->n_rotors * sizeof *u);
    return (l->step / period + 1) * period;
}

/* Set the motors' setpoints for now, and u to their rate. */
static void tell_motors(gtmr_loop *l, double *u)
{
    const gtmr_loop_plan *plan = l->plans;
    int64_t i, n = l->n_rotors, steps, into;
    const double *told;
    if (!plan->has_setpoints || l->cause) {
        /* Not beyond what rotors can follow, or they would not turn back at once. */
        double low = l->min_rotor_speed_hz, high = l->max_rotor_speed_hz;
        for (i = 0; i < n; i++) {
            double s = l->setpoints_hz[i];
            l->setpoints_hz[i] = s < low ? low : s > high ? high : s;
        }
        return;
    }
    steps = (l->step - plan->start) / l->plan_step;
    into = (l->step - plan->start) % l->plan_step;
    if (steps >= plan->n) {
        memcpy(l->setpoints_hz, plan->setpoints_hz + plan->n * n, n * sizeof *u);
        memset(u, 0, n * sizeof *u);
        return;
    }
    told = plan->setpoints_hz + steps * n;
    for (i = 0; i < n; i++) {
        double change = told[n + i] - told[i];
        l->setpoints_hz[i] = told[i] + (double)into / l->plan_step * change;
        u[i] = change / (l->plan_step * l->step_s);
    }
}

gtmr_loop_status gtmr_loop_advance(gtmr_loop *l, int64_t end)
{
    for (;;) {
        const gtmr_loop_plan *plan = l->plans;
        int64_t n, index;
        gtmr_loop_status status = meet(l);
        if (status != GTMR_LOOP_DONE || l->step >= end)
            return status;
        /* Until the next instant at which something changes. */
        n = smaller(end - l->step, l->plan_step - (l->step - plan->start) % l->plan_step);
        n = smaller(n, l->hold - l->step % l->hold);
        if (l->coming > 0)
            n = smaller(n, plan[1].acts - l->step);
        if (l->has_sensor)
            n = smaller(n, l->sample - l->step % l->sample);
        index = (l->step - plan->start) / l->plan_step;
        if (index < plan->n)
            memcpy(l->u, plan->u + index * l->n_rotors, l->n_rotors * sizeof *l->u);
        else
            memset(l->u, 0, l->n_rotors * sizeof *l->u);
        /* Before its first plan is due a vehicle waits, and needs no guard. */
        if (l->guard != NULL && !(l->coming > 0 && plan->kind == GTMR_LOOP_NO_PLAN)) {
            n = smaller(n, guarded(l, l->u) - l->step);
            l->guarded += l->cause ? n : 0;
        }
        if (l->has_motors)
            tell_motors(l, l->u);
        memcpy(l->w_g, l->gust_n, sizeof l->gust_n);
        if (l->advance(l->x, (int)n))
            return GTMR_LOOP_PLANT_ENDED;
        l->step += n;
        take_over(l);
        if (l->step % l->hold == 0)
            gtmr_loop_draw(l);
        if (l->has_sensor && l->step % l->sample == 0)
            gtmr_loop_measure(l);
    }
}
