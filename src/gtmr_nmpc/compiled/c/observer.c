// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.


/* What force and torque act beyond the nominal model: a Kalman filter of constant gains. */
#include <string.h>

#include "workspace.h"

void gtmr_forget(gtmr_controller *c)
{
    memset(&c->observer, 0, sizeof c->observer);
}

void gtmr_ahead(const gtmr_controller *c, const double *x, const double *xi, double dt,
                double *next)
{
    double in[N_XU + N_DISTURBED + 1], *to = in + N_XU;
    const double *theta = c->observer.theta;
    memcpy(in, x, N_X * sizeof(double));
    for (int j = 0; j < N_U; ++j) {
        in[N_X + j] = (xi[j] - x[BODY + j]) / dt;
    }
    for (int j = 0; j < 3; ++j) {
        to[j] = theta[j] + theta[3 + j];
        to[3 + j] = theta[6 + j];
    }
    to[N_DISTURBED] = dt;
    gtmr_model_motion(in, next);
    memcpy(next + BODY, xi, N_U * sizeof(double));
}

static void correct(gtmr_controller *c, const double *measured)
{
    const gtmr_parameters *by = &c->parameters;
    double *x = c->observer.x, *theta = c->observer.theta;
    for (int j = 0; j < 3; ++j) {
        const double far = measured[j] - x[j], fast = measured[6 + j] - x[6 + j];
        const double turned = remainder(measured[3 + j] - x[3 + j], 2.0 * 3.14159265358979323846);
        const double turning = measured[9 + j] - x[9 + j];
        const double(*shift)[2] = (const double(*)[2])by->translation_gains;
        const double(*turn)[2] = (const double(*)[2])(by->rotation_gains + 6 * j);
        x[j] += shift[0][0] * far + shift[0][1] * fast;
        x[6 + j] += shift[1][0] * far + shift[1][1] * fast;
        theta[j] += shift[2][0] * far + shift[2][1] * fast;
        theta[3 + j] += shift[3][0] * far + shift[3][1] * fast;
        x[3 + j] += turn[0][0] * turned + turn[0][1] * turning;
        x[9 + j] += turn[1][0] * turned + turn[1][1] * turning;
        theta[6 + j] += turn[2][0] * turned + turn[2][1] * turning;
    }
    for (int j = 0; j < N_THETA; ++j) {
        theta[j] = fmax(-by->theta_bounds[j], fmin(by->theta_bounds[j], theta[j]));
    }
}

static void begin(observer *o, const double *measured)
{
    memset(o->theta, 0, sizeof o->theta);
    memcpy(o->x, measured, sizeof o->x);
    o->begun = 1;
}

void gtmr_observe(gtmr_controller *c, const double *measured, double dt, double *estimate)
{
    observer *o = &c->observer;
    int steps = 0;
    if (dt > 0.0 && dt <= STAGES * PERIOD_S) {
        steps = (int)ceil(dt / PERIOD_S - 1e-6);
        steps = steps < 1 ? 1 : steps;
    }
    if (!o->begun || steps == 0) {
        begin(o, measured);
    } else {
        const double decay = pow(c->parameters.gust_decay, dt / (steps * PERIOD_S));
        for (int k = 0; k < steps; ++k) {
            double xi[N_U], next[N_X];
            for (int j = 0; j < N_U; ++j) {
                xi[j] = o->x[BODY + j] + (measured[BODY + j] - o->x[BODY + j]) / (steps - k);
            }
            gtmr_ahead(c, o->x, xi, dt / steps, next);
            memcpy(o->x, next, sizeof o->x);
            for (int j = 3; j < 6; ++j) {
                o->theta[j] *= decay;
            }
        }
        correct(c, measured);
        double sum = 0.0;
        for (int j = 0; j < N_X; ++j) {
            sum += o->x[j];
        }
        if (!isfinite(sum)) {
            /* What came before was out of this world. */
            begin(o, measured);
        }
    }
    memcpy(estimate, o->x, sizeof o->x);
    memcpy(estimate + N_X, o->theta, sizeof o->theta);
}
