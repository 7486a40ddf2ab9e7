// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* The inputs of one stage, within their bounds. */
#include "pivoting.h"

enum { ROUNDS = 10 };

/* Solve for the free inputs of a stage, those at bounds being given. */
static void solve_free(const double Q[N_U][LD_XU], const double *g, stage_solution *s)
{
    double L[N_U][N_U], y[N_U];
    int free[N_U], count = 0;
    for (int r = 0; r < N_U; ++r) {
        if (s->side[r] == 0) {
            free[count++] = r;
        }
    }
    for (int i = 0; i < count; ++i) {
        double rest = -g[free[i]];
        for (int r = 0; r < N_U; ++r) {
            rest -= s->side[r] != 0 ? Q[free[i]][N_X + r] * s->du[r] : 0.0;
        }
        for (int j = 0; j < i; ++j) {
            double entry = Q[free[i]][N_X + free[j]];
            for (int k = 0; k < j; ++k) {
                entry -= L[i][k] * L[j][k];
            }
            L[i][j] = entry * L[j][j];
            rest -= L[i][j] * y[j];
        }
        double diagonal = Q[free[i]][N_X + free[i]];
        for (int k = 0; k < i; ++k) {
            diagonal -= L[i][k] * L[i][k];
        }
        /* The diagonal is kept as its inverse. */
        L[i][i] = 1.0 / sqrt(diagonal);
        y[i] = rest * L[i][i];
    }
    for (int i = count - 1; i >= 0; --i) {
        for (int k = i + 1; k < count; ++k) {
            y[i] -= L[k][i] * y[k];
        }
        y[i] *= L[i][i];
        s->du[free[i]] = y[i];
    }
}

int gtmr_solve_stage(const input_cost *cost, const double *g, const stage_bounds *within,
                     stage_solution *s)
{
    for (int round = 0; round < ROUNDS; ++round) {
        int changes = 0, at_bounds = round == 0;
        for (int r = 0; r < N_U; ++r) {
            const double bound = s->side[r] > 0 ? within->upper[r] : within->lower[r];
            at_bounds &= s->side[r] == 0 || fabs(s->du[r] - bound) < INPUT_ROUNDING;
            s->du[r] = s->side[r] != 0 ? bound : s->du[r];
        }
        if (!at_bounds) {
            solve_free(cost->Q, g, s);
        }
        for (int r = 0; r < N_U; ++r) {
            signed char side = 0;
            s->multiplier[r] = 0.0;
            if (s->side[r] != 0) {
                double slope = g[r];
                for (int k = 0; k < N_U; ++k) {
                    slope += cost->Q[r][N_X + k] * s->du[k];
                }
                s->multiplier[r] = -slope;
                /* Between equal bounds an input stays. */
                side = s->side[r] * slope > 0.0 && within->lower[r] < within->upper[r]
                           ? 0
                           : s->side[r];
            } else if (s->du[r] > within->upper[r] + INPUT_ROUNDING) {
                side = 1;
            } else if (s->du[r] < within->lower[r] - INPUT_ROUNDING) {
                side = -1;
            }
            changes += side != s->side[r];
            s->side[r] = side;
        }
        if (changes == 0) {
            return 1;
        }
    }
    return 0;
}
