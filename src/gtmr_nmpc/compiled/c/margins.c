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

static void propagate_sensitivities(gtmr_controller *c)
{
    memset(c->Pi[0], 0, sizeof c->Pi[0]);
    for (int i = 0; i < STAGES; ++i) {
        const interval *at = &c->intervals[i];
        memcpy(c->Pi[i + 1], at->dF_dzeta, sizeof c->Pi[0]);
        const coefficients A = {at->jacobian[0], LD_XU, 1};
        combine(BODY, LD_ZETA, BODY, A, c->Pi[i][0], LD_ZETA, c->Pi[i + 1][0], LD_ZETA);
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

/* J_yx times column j of a matrix of as many rows as the body has states. */
static double by_gradient(const clearance *y, const double *matrix, int row_length, int j)
{
    double total = 0.0;
    for (int k = CLEARANCE_STATES - 1; k >= 0; --k) {
        total += y->gradient[k] * matrix[CLEARANCE_STATE[k] * row_length + j];
    }
    return total;
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
        for (int j = 0; j < N_ZETA; ++j) {
            const double Pi_y = is_robust(c) ? by_gradient(y, c->Pi[i][0], LD_ZETA, j) : 0.0;
            const double width = given->half_widths[j];
            const double counts = fabs(Pi_y) * width > ZERO_MARGIN;
            y->signs[j] = counts * c->margin_scale * sign(Pi_y) * width;
            y->by_channel[j] = fabs(Pi_y) * (c->margin_scale * width);
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

static int smaller(int a, int b)
{
    return a < b ? a : b;
}

/* Second derivatives of F, for intervals 0..last-1, along Pi s and the step. */
static void bending(gtmr_controller *c, const double *signs, int last, double to[][BODY])
{
    for (int first = 0; first < last; first += VEC) {
        for (int which = 0; which < VEC; ++which) {
            const int k = smaller(first + which, last - 1);
            double direction[BODY];
            worst_direction(c, k, signs, direction);
            vec *in = c->lanes_in;
            put(in, which, c->x[k], N_X);
            put(in += N_X, which, c->u[k], N_U);
            put(in += N_U, which, direction, BODY);
            put(in += BODY, which, signs, N_ZETA);
            put(in + N_ZETA, which, c->step[k], N_XU);
        }
        gtmr_model_bending(c->lanes_in, c->lanes_out);
        for (int which = 0; which < smaller(VEC, last - first); ++which) {
            get(c->lanes_out, which, to[first + which], BODY);
        }
    }
}

/* Change of J_yx Pi s along the step, for every stage whose signs are those of `like`. */
static void change_with_signs(gtmr_controller *c, int like, int last, double *change)
{
    const double *signs = c->clearances[like].signs;
    double bent[STAGES][BODY], turned[LD_XU] = {0.0};
    bending(c, signs, last, bent);
    for (int i = 1; i <= last; ++i) {
        const clearance *y = &c->clearances[i];
        double next[LD_XU] = {0.0}, direction[BODY], turn[CLEARANCE_STATES];
        for (int r = 0; r < BODY; ++r) {
            next[r] = bent[i - 1][r] + dot(c->intervals[i - 1].jacobian[r], turned, LD_XU);
        }
        memcpy(turned, next, sizeof turned);
        if (memcmp(y->signs, signs, sizeof y->signs) == 0) {
            worst_direction(c, i, signs, direction);
            curvature(c->x[i], direction, turn);
            change[i] = by_gradient(y, turned, 1, 0);
            for (int k = 0; k < CLEARANCE_STATES; ++k) {
                change[i] += turn[k] * c->step[i][CLEARANCE_STATE[k]];
            }
        }
    }
}

/* The same by gradients, where all are known. */
static void change_by_gradients(gtmr_controller *c, double *change)
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
    int done[STAGES + 1] = {0}, known = 1;
    for (int i = 1; i <= STAGES; ++i) {
        known &= c->has_margin_gradient[i];
    }
    if (known) {
        change_by_gradients(c, change);
        return;
    }
    for (int i = 1; i <= STAGES; ++i) {
        int last = i;
        for (int j = i; !done[i] && j <= STAGES; ++j) {
            if (memcmp(c->clearances[j].signs, c->clearances[i].signs,
                       sizeof c->clearances[j].signs) == 0) {
                last = j;
                done[j] = j > i;
            }
        }
        if (!done[i]) {
            change_with_signs(c, i, last, change);
        }
    }
}

/* J_yx of a stage carried back to the end of every interval before it. */
static void costates(const gtmr_controller *c, int stage, double lambda[][LD_XU])
{
    memset(lambda[stage - 1], 0, sizeof lambda[0]);
    for (int k = 0; k < CLEARANCE_STATES; ++k) {
        lambda[stage - 1][CLEARANCE_STATE[k]] = c->clearances[stage].gradient[k];
    }
    for (int k = stage - 2; k >= 0; --k) {
        memset(lambda[k], 0, sizeof lambda[0]);
        const coefficients later = {lambda[k + 1], 0, 1};
        combine(1, LD_XU, BODY, later, c->intervals[k + 1].jacobian[0], LD_XU, lambda[k], LD_XU);
    }
}

static void find_margin_gradient(gtmr_controller *c, int stage, double to[][LD_XU])
{
    const clearance *y = &c->clearances[stage];
    double lambda[STAGES][LD_XU], direction[BODY], turn[CLEARANCE_STATES];
    costates(c, stage, lambda);
    for (int first = 0; first < stage; first += VEC) {
        for (int which = 0; which < VEC; ++which) {
            const int k = smaller(first + which, stage - 1);
            worst_direction(c, k, y->signs, direction);
            vec *in = c->lanes_in;
            put(in, which, c->x[k], N_X);
            put(in += N_X, which, c->u[k], N_U);
            put(in += N_U, which, lambda[k], BODY);
            put(in += BODY, which, direction, BODY);
            put(in + BODY, which, y->signs, N_ZETA);
        }
        gtmr_model_adjoint(c->lanes_in, c->lanes_out);
        for (int which = 0; which < smaller(VEC, stage - first); ++which) {
            get(c->lanes_out, which, to[first + which], N_XU);
        }
    }
    memset(to[stage], 0, sizeof to[stage]);
    worst_direction(c, stage, y->signs, direction);
    curvature(c->x[stage], direction, turn);
    for (int k = 0; k < CLEARANCE_STATES; ++k) {
        to[stage][CLEARANCE_STATE[k]] = turn[k];
    }
}

const double (*gtmr_margin_gradient(gtmr_controller *c, int stage))[LD_XU]
{
    double(*rows)[LD_XU] = c->margin_gradient + stage * (stage + 1) / 2;
    if (!c->has_margin_gradient[stage]) {
        find_margin_gradient(c, stage, rows);
        c->has_margin_gradient[stage] = 1;
    }
    return (const double(*)[LD_XU])rows;
}
