// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* The clearance constraint along the iterate and its tightening: eq. (8), (9), (12), (13). */
#include <string.h>

#include "combine.h"
#include "workspace.h"

/* By the structure of [A B]: positions go through, and rates depend on none but rates. */
static void propagate_sensitivities(gtmr_controller *c)
{
    memset(c->Pi[0], 0, sizeof c->Pi[0]);
    for (int i = 0; i < STAGES; ++i) {
        const interval *at = &c->intervals[i];
        double(*now)[LD_ZETA] = c->Pi[i], (*next)[LD_ZETA] = c->Pi[i + 1];
        const coefficients A = {at->jacobian[0] + ETA, LD_XU, 1};
        const coefficients of_omega = {at->jacobian[OMEGA] + OMEGA, LD_XU, 1};
        const beginning direct = {at->dF_dzeta[0], LD_ZETA, 1.0};
        const beginning direct_of_omega = {at->dF_dzeta[OMEGA], LD_ZETA, 1.0};
        combine_from(OMEGA, LD_ZETA, BODY - ETA, A, now[ETA], LD_ZETA, direct, next[0], LD_ZETA);
        combine_from(BODY - OMEGA, LD_ZETA, BODY - OMEGA, of_omega, now[OMEGA], LD_ZETA,
                     direct_of_omega, next[OMEGA], LD_ZETA);
        for (int r = 0; r < ETA; ++r) {
            add_scaled(next[r], 1.0, now[r], LD_ZETA);
        }
    }
}

/*
 * Terms of alpha_p below this are zero by symmetry, as in hover, and their sign is rounding's [m].
 * The gradient of |Pi_y| jumps there: it takes 0, which is between its values on both sides.
 */
#define ZERO_MARGIN 1e-12

static double sign(double a)
{
    return (double)((a > 0.0) - (a < 0.0));
}

void gtmr_clearance_at(const gtmr_parameters *parameters, const double *x, double *constraint)
{
    double at[CLEARANCE_LENGTH + 2];
    memcpy(at, x, CLEARANCE_LENGTH * sizeof(double));
    at[CLEARANCE_LENGTH] = parameters->tower_radius_m;
    at[CLEARANCE_LENGTH + 1] = parameters->min_clearance_m;
    gtmr_model_clearance(at, constraint);
}

void gtmr_clearance_along_iterate(gtmr_controller *c)
{
    const gtmr_parameters *given = &c->parameters;
    if (is_robust(c)) {
        propagate_sensitivities(c);
    }
    for (int i = 0; i <= STAGES; ++i) {
        clearance *y = &c->clearances[i];
        double constraint[1 + CLEARANCE_STATES];
        gtmr_clearance_at(given, c->x[i], constraint);
        memcpy(y->gradient, constraint + 1, sizeof y->gradient);
        y->alpha_p = c->margin_scale * given->eps_s_m;
        y->alpha_g = c->margin_scale * given->gust_m * i * i;
        double Pi_y[LD_ZETA] = {0.0};
        for (int k = CLEARANCE_STATES - 1; k >= 0 && is_robust(c); --k) {
            add_scaled(Pi_y, y->gradient[k], c->Pi[i][CLEARANCE_STATE[k]], LD_ZETA);
        }
        for (int j = 0; j < N_ZETA; ++j) {
            const double width = given->half_widths[j];
            if (with_margin_gradient(c)) {
                const double counts = fabs(Pi_y[j]) * width > ZERO_MARGIN;
                y->signs[j] = counts * c->margin_scale * sign(Pi_y[j]) * width;
            }
            y->by_channel[j] = fabs(Pi_y[j]) * (c->margin_scale * width);
            y->alpha_p += y->by_channel[j];
        }
        y->residual = constraint[0] + y->alpha_p + y->alpha_g;
    }
}

void gtmr_iterate(const gtmr_controller *c, double *x, double *u, double *Pi)
{
    memcpy(x, c->x, sizeof c->x);
    memcpy(u, c->u, sizeof c->u);
    for (int i = 0; i <= STAGES; ++i) {
        for (int r = 0; r < BODY; ++r, Pi += N_ZETA) {
            memcpy(Pi, c->Pi[i][r], N_ZETA * sizeof(double));
        }
    }
}

void gtmr_tighten(gtmr_controller *c, const double *alpha)
{
    c->is_tightened = 1;
    memcpy(c->told[0], alpha, sizeof c->told[0]);
    memset(c->told[1], 0, sizeof c->told[1]);
    for (int i = 0; i <= STAGES; ++i) {
        clearance *y = &c->clearances[i];
        double constraint[1 + CLEARANCE_STATES];
        gtmr_clearance_at(&c->parameters, c->x[i], constraint);
        memset(y->by_channel, 0, sizeof y->by_channel);
        y->alpha_p = alpha[i];
        y->alpha_g = 0.0;
        y->residual = constraint[0] + alpha[i];
    }
    gtmr_note_prepared(c);
}
