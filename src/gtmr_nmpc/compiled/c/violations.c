// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* Which rows of the QP a solution breaks. */
#include "combine.h"
#include "workspace.h"

/* Least violation that counts: of a row scaled to norm 1, and from the rounding of its value. */
#define VIOLATED 1e-10
#define ROUNDING 4e-15

/* By how much v changes the value of each row. */
static void changes(const gtmr_controller *c, double *change)
{
    double speed[N_U] = {0.0};
    for (int i = 0; i < STAGES; ++i) {
        const int first = row_of(i, 0), length = row_length(first);
        for (int j = 0; j < N_U && !c->only_clearances; j += TILE_ROWS) {
            const double *row[TILE_ROWS];
            double along[TILE_ROWS];
            for (int r = 0; r < TILE_ROWS; ++r) {
                /* Past the last input, clearance. */
                row[r] = c->rows[first + (j + r < N_U ? j + r : CLEARANCE)];
            }
            dot_tile(TILE_ROWS, row, c->v, length, along);
            for (int r = 0; r < TILE_ROWS && j + r < N_U; ++r) {
                change[first + j + r] = along[r];
                /* Speeds are sums of inputs: no need to go through their rows. */
                speed[j + r] += PERIOD_S * along[r];
                change[first + N_U + j + r] = speed[j + r];
            }
        }
        /* One that is left out has no row, or that of another step. */
        const int row_counts = c->inverse_norm[first + CLEARANCE] != 0.0;
        change[first + CLEARANCE] =
            row_counts ? dot(c->rows[first + CLEARANCE], c->v, length) : 0.0;
    }
}

/* Scaled violation of a row outside the working set, whose value changed; negative below. */
static double violation_of(const gtmr_controller *c, int row, double change)
{
    const double value = c->value[row] + change;
    const double above = value - c->upper[row], below = c->lower[row] - value;
    const double more = above > below ? above : below;
    const double worse = (more - ROUNDING) * c->inverse_norm[row];
    const int counts = (worse > VIOLATED) & !c->in_set[row];
    return counts ? (above > below ? worse : -worse) : 0.0;
}

int gtmr_violations(const gtmr_controller *c, double *restrict violation)
{
    const int stride = row_stride(c);
    double change[N_ROWS], most = 0.0;
    int worst = -1;
    changes(c, change);
    if (c->only_clearances) {
        for (int i = CLEARANCE; i < N_ROWS; i += STAGE_ROWS) {
            violation[i] = violation_of(c, i, change[i]);
        }
    } else {
        /* Without branches, for the compiler to take several rows at a time. */
        for (int i = 0; i < N_ROWS; ++i) {
            violation[i] = violation_of(c, i, change[i]);
        }
    }
    for (int i = first_row(c); i < N_ROWS; i += stride) {
        if (fabs(violation[i]) > most) {
            most = fabs(violation[i]);
            worst = i;
        }
    }
    return worst;
}
