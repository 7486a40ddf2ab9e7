// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* The working set of the dual active-set method: which rows, and the factor of their Gram matrix. */
#include <string.h>

#include "combine.h"
#include "workspace.h"

/* Squared sine of the angle below which a row is taken as dependent on the others. */
#define DEPENDENT 1e-9

double gtmr_compliance(const gtmr_controller *c, const active_row *a)
{
    return a->soft ? a->scale * a->scale / (2.0 * c->parameters.slack_l2) : 0.0;
}

/* TILE_ROWS members from `first` on; past the end the last one again. Returns their length. */
static int tile_of(const gtmr_controller *c, int first, const active_row *member[TILE_ROWS],
                   const double *row[TILE_ROWS])
{
    const int last = c->active.count - 1;
    int length = 0;
    for (int r = 0; r < TILE_ROWS; ++r) {
        member[r] = &c->active.member[first + r < last ? first + r : last];
        row[r] = c->rows[member[r]->row];
        /* Behind a row's own length there are zeros. */
        length = row_length(member[r]->row) > length ? row_length(member[r]->row) : length;
    }
    return length;
}

void gtmr_working_set_along(const gtmr_controller *c, const double *v, int length, double *out)
{
    const active_row *member[TILE_ROWS];
    const double *row[TILE_ROWS];
    for (int i = 0; i < c->active.count; i += TILE_ROWS) {
        const int longest = tile_of(c, i, member, row);
        dot_tile(TILE_ROWS, row, v, longest < length ? longest : length, out + i);
        for (int r = 0; r < TILE_ROWS; ++r) {
            out[i + r] *= member[r]->side * member[r]->scale;
        }
    }
}

void gtmr_working_set_combine(const gtmr_controller *c, const double *by, double *v)
{
    const active_row *member[TILE_ROWS];
    const double *row[TILE_ROWS];
    for (int i = 0; i < c->active.count; i += TILE_ROWS) {
        double factor[TILE_ROWS];
        const int length = tile_of(c, i, member, row);
        for (int r = 0; r < TILE_ROWS; ++r) {
            const int counts = i + r < c->active.count;
            factor[r] = counts ? by[i + r] * member[r]->side * member[r]->scale : 0.0;
        }
        add_tile(TILE_ROWS, factor, row, length, v);
    }
}

/* Several columns at a time, as each alone waits for the one before it. */
void gtmr_working_set_forward(const working_set *set, double *y)
{
    int j = 0;
    while (j < set->count && y[j] == 0.0) {
        ++j;
    }
    for (j -= j % TILE_ROWS; j + TILE_ROWS <= set->count; j += TILE_ROWS) {
        const double *column[TILE_ROWS];
        double known[TILE_ROWS], less[TILE_ROWS];
        for (int r = 0; r < TILE_ROWS; ++r) {
            double rest = y[j + r];
            column[r] = set->factor[j + r] + j / VEC * VEC;
            for (int k = 0; k < r; ++k) {
                rest -= known[k] * set->factor[j + k][j + r];
            }
            known[r] = rest * set->inverse_diagonal[j + r];
            less[r] = -known[r];
        }
        add_tile(TILE_ROWS, less, column, set->count - j / VEC * VEC, y + j / VEC * VEC);
        memcpy(y + j, known, sizeof known);
    }
    for (; j < set->count; ++j) {
        y[j] *= set->inverse_diagonal[j];
        for (int i = j + 1; i < set->count; ++i) {
            y[i] -= y[j] * set->factor[j][i];
        }
    }
}

void gtmr_working_set_backward(const working_set *set, double *y)
{
    const int whole = set->count - set->count % TILE_ROWS;
    for (int i = set->count; i % VEC != 0; ++i) {
        y[i] = 0.0;
    }
    for (int j = set->count - 1; j >= whole; --j) {
        for (int i = j + 1; i < set->count; ++i) {
            y[j] -= set->factor[j][i] * y[i];
        }
        y[j] *= set->inverse_diagonal[j];
    }
    for (int j = whole - TILE_ROWS; j >= 0; j -= TILE_ROWS) {
        const int from = j / VEC * VEC;
        const double *column[TILE_ROWS];
        double rest[TILE_ROWS], behind[TILE_ROWS];
        for (int r = 0; r < TILE_ROWS; ++r) {
            column[r] = set->factor[j + r] + from;
        }
        memcpy(rest, y + j, sizeof rest);
        memset(y + j, 0, sizeof rest);
        dot_tile(TILE_ROWS, column, y + from, PADDED(set->count) - from, behind);
        for (int r = TILE_ROWS - 1; r >= 0; --r) {
            rest[r] -= behind[r];
            for (int k = r + 1; k < TILE_ROWS; ++k) {
                rest[r] -= set->factor[j + r][j + k] * y[j + k];
            }
            y[j + r] = rest[r] * set->inverse_diagonal[j + r];
        }
    }
}

int gtmr_working_set_append(gtmr_controller *c, const active_row *row, double *w)
{
    working_set *set = &c->active;
    const int n = set->count;
    const double own = gtmr_compliance(c, row);
    double diagonal = 1.0 + own;
    gtmr_working_set_along(c, c->rows[row->row], row_length(row->row), w);
    for (int i = 0; i < n; ++i) {
        w[i] *= row->side * row->scale;
    }
    gtmr_working_set_forward(set, w);
    for (int i = 0; i < n; ++i) {
        diagonal -= w[i] * w[i];
    }
    if (n == MAX_ACTIVE - 1 || diagonal < DEPENDENT * (1.0 + own)) {
        return 0;
    }
    for (int i = 0; i < n; ++i) {
        set->factor[i][n] = w[i];
    }
    memset(set->factor[n], 0, n * sizeof(double));
    set->factor[n][n] = sqrt(diagonal);
    set->inverse_diagonal[n] = 1.0 / set->factor[n][n];
    set->member[n] = *row;
    set->count = n + 1;
    c->in_set[row->row] = 1;
    return 1;
}

/* Take a row out of the factor: what it explained is added to the rows behind it. */
active_row gtmr_working_set_remove(gtmr_controller *c, int at)
{
    working_set *set = &c->active;
    active_row out = set->member[at];
    const int n = set->count - 1, behind = n - at;
    double freed[LD_ACTIVE];
    memcpy(freed, &set->factor[at][at + 1], behind * sizeof(double));
    for (int j = 0; j < at; ++j) {
        memmove(&set->factor[j][at], &set->factor[j][at + 1], behind * sizeof(double));
    }
    for (int j = at; j < n; ++j) {
        const double *restrict old = &set->factor[j + 1][j + 1];
        double *restrict column = &set->factor[j][j];
        double *restrict rest = &freed[j - at];
        const double diagonal = sqrt(old[0] * old[0] + rest[0] * rest[0]);
        const double cosine = old[0] / diagonal, sine = rest[0] / diagonal;
        column[0] = diagonal;
        set->inverse_diagonal[j] = 1.0 / diagonal;
        for (int i = 1; i < n - j; ++i) {
            column[i] = cosine * old[i] + sine * rest[i];
            rest[i] = cosine * rest[i] - sine * old[i];
        }
    }
    memmove(&set->member[at], &set->member[at + 1], behind * sizeof out);
    set->count = n;
    if (at < set->settled) {
        out.excess = 0.0;
        --set->settled;
    }
    c->in_set[out.row] = 0;
    return out;
}
