// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* The plans that were sent, and the state that they have led to since a measurement. */
#include <string.h>

#include "workspace.h"

/* Pieces of time below this are rounding. */
#define SHORTEST_S 1e-6

/* The plan k after the oldest one. */
static sent_plan *sent(gtmr_controller *c, int k)
{
    return &c->progress.sent[(c->progress.oldest + k) % SENT_PLANS];
}

static void drop_oldest(gtmr_controller *c)
{
    c->progress.oldest = (c->progress.oldest + 1) % SENT_PLANS;
    --c->progress.sent_count;
}

void gtmr_sent_add(gtmr_controller *c, double start_s, double oldest_s, const double *setpoints)
{
    progress *p = &c->progress;
    while (p->sent_count > 0 && sent(c, p->sent_count - 1)->start_s >= start_s) {
        --p->sent_count;
    }
    if (p->sent_count == SENT_PLANS) {
        drop_oldest(c);
    }
    sent_plan *plan = sent(c, p->sent_count++);
    plan->start_s = start_s;
    memcpy(plan->u, c->last.u, sizeof plan->u);
    memcpy(plan->setpoints, setpoints, sizeof plan->setpoints);
    while (p->sent_count > 1 && sent(c, 1)->start_s <= oldest_s) {
        drop_oldest(c);
    }
}

static double clip(double value, double low, double high)
{
    return fmin(fmax(value, low), high);
}

/* Where a rotor's speed goes in dt, a part of a stage of a plan, which may be over. */
static double rotor_speed(const gtmr_parameters *given, const sent_plan *plan, int rotor,
                          double xi, double stage, double into, double dt)
{
    const double lag = given->motor_lag_s, most = given->max_rotor_acceleration_hz_s * dt;
    double first = xi, last = xi;
    if (stage >= STAGES) {
        first = last = lag > 0.0 ? plan->setpoints[STAGES][rotor] : xi;
    } else if (lag > 0.0) {
        const double from = plan->setpoints[(int)stage][rotor];
        const double span = plan->setpoints[(int)stage + 1][rotor] - from;
        first = from + into * span;
        last = first + span * (dt / PERIOD_S);
    } else {
        last = xi + dt * plan->u[(int)stage][rotor];
    }
    if (lag > 0.0) {
        /* A first-order lag behind a ramp. */
        const double behind = lag * (last - first) / dt;
        last = last - behind + (xi - first + behind) * exp(-dt / lag);
    }
    last = xi + clip(last - xi, -most, most);
    /* A rotor outside its limits is taken as it is. */
    return clip(last, fmin(given->min_rotor_speed_hz, xi), fmax(given->max_rotor_speed_hz, xi));
}

void gtmr_sent_ahead(gtmr_controller *c, double *x, double t, double now)
{
    while (now - t > SHORTEST_S) {
        const sent_plan *plan = NULL;
        double end = now, xi[N_U], next[N_X];
        int k = c->progress.sent_count;
        for (; k > 0 && plan == NULL; --k) {
            const sent_plan *one = sent(c, k - 1);
            if (one->start_s <= t + SHORTEST_S) {
                plan = one;
            } else {
                end = fmin(end, one->start_s);
            }
        }
        memcpy(xi, x + BODY, sizeof xi);
        if (plan != NULL) {
            const double stage = floor((t - plan->start_s + SHORTEST_S) / PERIOD_S);
            const double into = (t - plan->start_s) / PERIOD_S - stage;
            if (stage < STAGES) {
                end = fmin(end, plan->start_s + (stage + 1.0) * PERIOD_S);
            }
            for (int r = 0; r < N_U; ++r) {
                xi[r] = rotor_speed(&c->parameters, plan, r, x[BODY + r], stage, into, end - t);
            }
        }
        gtmr_ahead(c, x, xi, end - t, next);
        memcpy(x, next, sizeof next);
        t = end;
    }
}

/*
 * A motor that follows its setpoint s by xi' = (s - xi) / T has the planned speed if s = xi + T u;
 * between the stages both are linear, and of a plan it is the first stage that is flown.
 */
void gtmr_setpoints(const gtmr_controller *c, double setpoints[][N_U])
{
    const gtmr_parameters *given = &c->parameters;
    for (int i = 0; i <= STAGES; ++i) {
        memcpy(setpoints[i], c->last.x[i] + BODY, sizeof setpoints[i]);
        for (int r = 0; given->motor_lag_s > 0.0 && r < N_U; ++r) {
            const double lead = given->motor_lag_s * c->last.u[i > 0 ? i - 1 : 0][r];
            setpoints[i][r] = clip(setpoints[i][r] + lead, given->min_rotor_speed_hz,
                                   given->max_rotor_speed_hz);
        }
    }
}
