/* Copyright 2026 the gtmr authors
 * SPDX-License-Identifier: Apache-2.0 */
/* The working set of the dual active-set method: which rows, and the factor of their Gram matrix. */
#include <string.h>

#include "combine.h"
#include "workspace.h"

/* Squared sine of the angle below which a row is taken as dependent on the others. */
#define DEPENDENT 1e-13
/* Below this it is found by projection, as the difference of two numbers near 1 is too coarse. */
#define DOUBTFUL 1e-9

double compliance(const gtmr_controller *c, const active_row *a)
{
    return a->soft ? a->scale * a->scale / (2.0 * c->parameters.slack_l2) : 0.0;
}

double along(const gtmr_controller *c, const active_row *a, const double *v)
{
    return a->side * a->scale * dot(c->rows[a->row], v, row_length(a->row));
}

void add_row(const gtmr_controller *c, const active_row *a, double factor, double *v)
{
    add_scaled(v, factor * a->side * a->scale, c->rows[a->row], row_length(a->row));
}

/* Solve L y = y; what lies behind the end of y is overwritten. */
void working_set_forward(const working_set *set, double *y)
{
    int j = 0;
    while (j < set->count && y[j] == 0.0) {
        ++j;
    }
    for (; j < set->count; ++j) {
        const double known = y[j] * set->inverse_diagonal[j];
        const double *column = set->factor[j];
        for (int i = j / VEC * VEC; i < set->count; i += VEC) {
            store(y + i, load(y + i) - known * load(column + i));
        }
        y[j] = known;
    }
}

/* Solve L' y = y. */
void working_set_backward(const working_set *set, double *y)
{
    for (int i = set->count; i % VEC != 0; ++i) {
        y[i] = 0.0;
    }
    for (int j = set->count - 1; j >= 0; --j) {
        const double *column = set->factor[j];
        const double unknown = y[j];
        vec lanes = vec_of(0.0);
        y[j] = 0.0;
        for (int i = j / VEC * VEC; i < set->count; i += VEC) {
            lanes += load(column + i) * load(y + i);
        }
        y[j] = (unknown - sum(lanes)) * set->inverse_diagonal[j];
    }
}

/* Whether a rotor's speed before a stage follows from its active rows. */
static int speed_follows(const gtmr_controller *c, int rotor, int stage)
{
    int first = stage, last = stage;
    while (first > 0 && c->in_set[row_of(first - 1, rotor)]) {
        --first;
    }
    while (last < STAGES && c->in_set[row_of(last, rotor)]) {
        ++last;
    }
    /* The speed before stage 0 is measured. */
    int follows = first == 0;
    for (int i = first > 0 ? first : 1; i <= last && !follows; ++i) {
        follows = c->in_set[row_of(i - 1, N_U + rotor)];
    }
    return follows;
}

/*
 * Whether a rotor's row follows from its active ones, as its speeds are the sums of its inputs;
 * without rounding, unlike the factor.
 */
static int follows(const gtmr_controller *c, int row)
{
    const int stage = row / STAGE_ROWS, which = row % STAGE_ROWS, rotor = which % N_U;
    return which != CLEARANCE && speed_follows(c, rotor, stage + 1) &&
           (which >= N_U || speed_follows(c, rotor, stage));
}

/*
 * What is left of a row once its projection on the working set is taken off, length squared; each
 * soft row has a dimension of its own besides. w: L^-1 times its Gram row. Projected twice, as
 * once loses half the digits.
 */
static double squared_sine(const gtmr_controller *c, const active_row *of, const double *w)
{
    const working_set *set = &c->active;
    double rest[LD_V] = {0.0}, by[LD_ACTIVE], total[LD_ACTIVE] = {0.0}, own = 0.0;
    add_row(c, of, 1.0, rest);
    memcpy(by, w, set->count * sizeof(double));
    for (int pass = 0; pass < 2; ++pass) {
        working_set_backward(set, by);
        for (int i = 0; i < set->count; ++i) {
            total[i] += by[i];
            add_row(c, &set->member[i], -by[i], rest);
        }
        own = 0.0;
        for (int i = 0; i < set->count; ++i) {
            const double gives = compliance(c, &set->member[i]);
            own += gives * total[i] * total[i];
            by[i] = along(c, &set->member[i], rest) - gives * total[i];
        }
        working_set_forward(set, by);
    }
    return dot(rest, rest, LD_V) + own;
}

static double gram(const gtmr_controller *c, const active_row *a, const active_row *b)
{
    const int length = row_length(a->row < b->row ? a->row : b->row);
    return a->side * a->scale * b->side * b->scale *
           dot(c->rows[a->row], c->rows[b->row], length);
}

int working_set_append(gtmr_controller *c, const active_row *row, int needed, double *w)
{
    working_set *set = &c->active;
    const int n = set->count, dependent = follows(c, row->row);
    const double own = compliance(c, row);
    double diagonal = 1.0 + own;
    if (dependent && !needed) {
        return 0;
    }
    for (int i = 0; i < n; ++i) {
        w[i] = gram(c, &set->member[i], row);
    }
    working_set_forward(set, w);
    for (int i = 0; i < n; ++i) {
        diagonal -= w[i] * w[i];
    }
    if (diagonal < DOUBTFUL * (1.0 + own)) {
        diagonal = needed && !dependent ? squared_sine(c, row, w) + own : 0.0;
    }
    if (n == MAX_ACTIVE - 1 || dependent || diagonal < DEPENDENT * (1.0 + own)) {
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
active_row working_set_remove(gtmr_controller *c, int at)
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
