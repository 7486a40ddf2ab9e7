// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

#define _POSIX_C_SOURCE 199309L

#include "gtmr_flight.h"

#include <math.h>
#include <string.h>
#include <time.h>

int64_t gtmr_flight_size(void)
{
    return sizeof(gtmr_flight);
}

static double clock_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e3 * (double)now.tv_sec + 1e-6 * (double)now.tv_nsec;
}

static void put(double *rows, int64_t k, const double *row, int64_t n)
{
    memcpy(rows + k * n, row, n * sizeof *row);
}

/* Keep for a step what was told in the one before, as no measurement has arrived. */
static void keep(gtmr_flight *f)
{
    const int64_t k = f->k, n = f->loop->n_rotors, stages = f->stages + 1;
    put(f->log_measured, k, f->log_measured + (k - 1) * (12 + n), 12 + n);
    put(f->log_u, k, f->log_u + (k - 1) * n, n);
    put(f->log_alpha_p, k, f->log_alpha_p + (k - 1) * stages, stages);
    put(f->log_alpha_g, k, f->log_alpha_g + (k - 1) * stages, stages);
    put(f->log_slack, k, f->log_slack + (k - 1) * stages, stages);
    f->log_solve_ms[k] = f->log_solve_ms[k - 1];
    f->log_failed[k] = f->log_failed[k - 1];
}

static int all_finite(const double *values, int64_t n)
{
    int64_t i;
    double sum = 0.0;
    for (i = 0; i < n; i++)
        sum += 0.0 * values[i];
    return sum == 0.0;
}

/* Let the controller decide; 0 if no measurement has arrived for it. */
static int decide(gtmr_flight *f, int *status)
{
    gtmr_loop *l = f->loop;
    const int64_t k = f->k, n = l->n_rotors, stages = f->stages + 1;
    const int64_t made = l->has_sensor ? gtmr_loop_newest(l) : l->step;
    double begin_ms;
    put(f->log_x, k, l->x, 12 + n);
    put(f->log_gust_n, k, l->gust_n, 3);
    if (l->has_wind)
        put(f->log_air_m_s, k, l->air_m_s, 3);
    if (made <= f->handed_out) {
        keep(f);
        return 0;
    }
    f->handed_out = made;
    memcpy(f->x, l->has_sensor ? l->newest_x : l->x, (12 + n) * sizeof *f->x);
    put(f->log_measured, k, f->x, 12 + n);
    f->stamp_s = made * l->step_s;
    f->now_s = f->tells_now ? f->stamp_s + f->delay_s : f->stamp_s;
    begin_ms = clock_ms();
    *status = f->controller(f->controller_memory, f->stamp_s, f->x, f->now_s, f->plan);
    f->log_solve_ms[k] = clock_ms() - begin_ms;
    f->log_failed[k] = *status == f->failed;
    put(f->log_u, k, f->u, n);
    put(f->log_alpha_p, k, f->alpha_p, stages);
    put(f->log_alpha_g, k, f->alpha_g, stages);
    put(f->log_slack, k, f->slack, stages);
    return 1;
}

/* Hand its plan over; 0 if there is no room for it. */
static int command(gtmr_flight *f)
{
    gtmr_loop *l = f->loop;
    int64_t start = (int64_t)rint((f->now_s + f->transport_s) / l->step_s);
    int64_t acts = l->step + (int64_t)rint(f->transport_s / l->step_s);
    return gtmr_loop_play(l, start, start > acts ? start : acts, GTMR_LOOP_USABLE, f->stages, f->u,
                          l->has_motors ? f->setpoints_hz : NULL);
}

int gtmr_flight_run(gtmr_flight *f, int64_t until)
{
    gtmr_loop *l = f->loop;
    while (f->k < until) {
        int status = 0;
        if (f->phase == GTMR_FLIGHT_DECIDES) {
            const int64_t n = l->n_rotors;
            f->phase = decide(f, &status) ? GTMR_FLIGHT_COMMANDS : GTMR_FLIGHT_FLIES;
            if (status < 0)
                return GTMR_FLIGHT_REFUSED;
            if (!all_finite(f->u, f->stages * n) ||
                !all_finite(f->setpoints_hz, (f->stages + 1) * n))
                return GTMR_FLIGHT_NOT_FINITE;
        }
        if (f->phase == GTMR_FLIGHT_COMMANDS) {
            if (!command(f))
                return GTMR_FLIGHT_NEEDS_ROOM;
            f->phase = GTMR_FLIGHT_FLIES;
        }
        status = gtmr_loop_advance(l, (f->k + 1) * l->plan_step);
        if (status)
            return status;
        f->log_guard[f->k++] = l->cause != 0;
        f->phase = GTMR_FLIGHT_DECIDES;
    }
    return GTMR_LOOP_DONE;
}
