// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* A step as a whole, and what passes from one to the next. */
#include <string.h>
#include <time.h>

#include "workspace.h"

#define PI 3.14159265358979323846
enum { PITCH = 4, YAW = 5, GUST = 3, REFERENCE_YAW = 11 };

static double clock_s(void)
{
#ifdef CLOCK_MONOTONIC
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
#else
    return 0.0;
#endif
}

void gtmr_note_prepared(gtmr_controller *c)
{
    c->progress.prepare_s = clock_s() - c->progress.clock_s;
}

void gtmr_reset(gtmr_controller *c)
{
    progress *p = &c->progress;
    p->is_prepared = p->begun = p->is_a_start = p->sent_count = 0;
    p->observed = p->observed_steps = 0;
    memset(p->theta, 0, sizeof p->theta);
    gtmr_forget(c);
}

void gtmr_set_mode(gtmr_controller *c, double margin_scale, double offset_free)
{
    progress *p = &c->progress;
    if (offset_free == 0.0 && p->offset_free != 0.0) {
        gtmr_disturb(c, NULL);
        p->observed = p->observed_steps = 0;
        memset(p->theta, 0, sizeof p->theta);
        gtmr_forget(c);
    }
    p->margin_scale = margin_scale;
    p->offset_free = offset_free;
    p->is_prepared = 0;
}

void gtmr_set_margins(gtmr_controller *c, const double *table, int rows)
{
    c->progress.margins = table;
    c->progress.margin_rows = rows;
    c->progress.is_prepared = 0;
}

double gtmr_last_time(const gtmr_controller *c)
{
    return c->progress.begun ? c->progress.last_s : NAN;
}

/* Copy a state, its yaw turned to within pi of the reference's; 0 if it is not finite. */
static int take_state(const gtmr_controller *c, double t, const double *x, double *to)
{
    double follow[3 + sizeof c->parameters.reference / sizeof(double)], reference[N_H], sum = 0.0;
    for (int j = 0; j < N_X; ++j) {
        sum += to[j] = x[j];
    }
    follow[0] = t;
    follow[1] = c->parameters.tower_radius_m;
    follow[2] = c->parameters.min_clearance_m;
    memcpy(follow + 3, c->parameters.reference, sizeof c->parameters.reference);
    gtmr_model_reference(follow, reference);
    to[YAW] += 2.0 * PI * rint((reference[REFERENCE_YAW] - to[YAW]) / (2.0 * PI));
    return isfinite(sum) != 0;
}

/* Start from the last plan, if it reaches the time and is fit for it. */
static int start_warm(gtmr_controller *c, double now)
{
    const progress *p = &c->progress;
    const double steps = rint((now - p->last_s) / PERIOD_S);
    if (!p->begun || !p->is_a_start || !(steps >= 0.0 && steps < STAGES)) {
        return 0;
    }
    gtmr_warm(c, (int)steps);
    return 1;
}

/* Tighten by the row of the table that is due. */
static void tighten_by_table(gtmr_controller *c)
{
    const progress *p = &c->progress;
    const int last = p->margin_rows - 1;
    const int row = p->observed_steps < last ? p->observed_steps : last;
    double alpha[STAGES + 1];
    const double *alpha_p = p->margins + row * 2 * (STAGES + 1), *alpha_g = alpha_p + STAGES + 1;
    for (int i = 0; i <= STAGES; ++i) {
        alpha[i] = alpha_p[i] + alpha_g[i];
    }
    gtmr_tighten(c, alpha);
    memcpy(c->told, alpha_p, sizeof c->told);
}

int gtmr_begin(gtmr_controller *c, double t, const double *x, double now)
{
    progress *p = &c->progress;
    double state[N_X];
    if (p->is_prepared && p->prepared_s == now) {
        return p->observed_steps;
    }
    if (x != NULL && (!take_state(c, t, x, state) || !(t <= now && now < HUGE_VAL))) {
        return -1;
    }
    p->clock_s = clock_s();
    if (p->offset_free > 0.0) {
        double theta[N_THETA];
        for (int j = 0; j < N_THETA; ++j) {
            theta[j] = p->offset_free * p->theta[j];
        }
        gtmr_disturb(c, theta);
    }
    if (!start_warm(c, now)) {
        if (x == NULL) {
            return -1;
        }
        gtmr_cold(c, state);
    }
    gtmr_prepare(c, now, p->margin_scale);
    if (p->margin_rows > 0) {
        tighten_by_table(c);
    }
    gtmr_note_prepared(c);
    p->is_prepared = 1;
    p->prepared_s = now;
    return p->observed_steps;
}

/* Estimate state and disturbances from a measured state. */
static void observe(gtmr_controller *c, double t, const double *measured, double now, double *x)
{
    progress *p = &c->progress;
    const double dt = p->observed ? t - p->observed_s : 0.0;
    const double until_s = now - t + PERIOD_S; /* the next plan begins a sampling time later */
    double estimate[N_X + N_THETA];
    p->observed_steps = 0.0 < dt && dt <= STAGES * PERIOD_S ? p->observed_steps + 1 : 0;
    p->observed = 1;
    p->observed_s = t;
    gtmr_observe(c, measured, dt, estimate);
    memcpy(x, estimate, N_X * sizeof *x);
    x[YAW] += 2.0 * PI * rint((measured[YAW] - x[YAW]) / (2.0 * PI));
    memcpy(p->theta, estimate + N_X, sizeof p->theta);
    for (int j = GUST; j < GUST + 3; ++j) {
        p->theta[j] *= exp(-until_s / c->parameters.gust_time_s);
    }
}

/* Where the vehicle is when the command acts, as measured or estimated. */
static void present(gtmr_controller *c, double t, double *x, double now)
{
    const double share = c->progress.offset_free;
    double measured[N_X];
    memcpy(measured, x, sizeof measured);
    if (share > 0.0) {
        observe(c, t, measured, now, x);
    }
    if (now > t) {
        gtmr_sent_ahead(c, x, t, now);
    }
    if (0.0 < share && share < 1.0) {
        gtmr_sent_ahead(c, measured, t, now);
        for (int j = 0; j < N_X; ++j) {
            x[j] = (1.0 - share) * measured[j] + share * x[j];
        }
    }
}

/*
 * Whether a plan stays where the model holds, and with it can be the next one's iterate. One step
 * too long for the linearisation that it came from goes through the tower's axis, by the slack it
 * needs, or through a pitch of 90 degrees, where Euler angles have no rates.
 */
static int is_sound(const gtmr_controller *c, const double *plan)
{
    const double *slack = plan + PLAN_SETPOINTS - (STAGES + 1);
    const double most = c->parameters.tower_radius_m + c->parameters.min_clearance_m;
    int sound = 1;
    for (int i = 0; i <= STAGES; ++i) {
        sound &= !(slack[i] > most) && fabs(plan[i * N_X + PITCH]) < PI / 2.0;
    }
    return sound;
}

gtmr_status gtmr_finish(gtmr_controller *c, double t, const double *x, double now, double *plan)
{
    progress *p = &c->progress;
    const double start_s = clock_s();
    double state[N_X], *notes = plan + PLAN_NOTES;
    if (!take_state(c, t, x, state) || !(t <= now && now < HUGE_VAL)) {
        return GTMR_REFUSED;
    }
    notes[0] = p->observed_steps;
    notes[1] = p->prepare_s;
    present(c, t, state, now);
    const gtmr_status status = gtmr_feedback(c, state, plan);
    p->is_prepared = 0;
    p->begun = 1;
    p->last_s = now;
    p->is_a_start = status != GTMR_FAILED && is_sound(c, plan);
    if (now > t || c->parameters.delay_s > 0.0) {
        gtmr_sent_add(c, now, t, plan + PLAN_SETPOINTS);
    }
    notes[2] = clock_s() - start_s;
    return status;
}

gtmr_status gtmr_step(gtmr_controller *c, double t, const double *x, double now, double *plan)
{
    if (gtmr_begin(c, t, x, now) < 0) {
        return GTMR_REFUSED;
    }
    return gtmr_finish(c, t, x, now, plan);
}
