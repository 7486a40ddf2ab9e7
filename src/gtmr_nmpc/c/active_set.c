/* Copyright 2026 the gtmr authors
 * SPDX-License-Identifier: Apache-2.0 */
/*
 * Dual active-set method (Goldfarb and Idnani) for |v|^2 / 2 with rows between bounds.
 *
 * v = -sum lambda_j a_j over the working set, whose Gram matrix is kept as a Cholesky factor. The
 * dual objective never falls, so that any multipliers >= 0, such as the last step's, are a start.
 * The exact penalty l1 s + l2 s^2 caps a multiplier softly: up to l1 the row is hard, above it
 * the row gives way by s = (lambda - l1) / (2 l2), which adds to the Gram matrix's diagonal.
 */
#include <string.h>

#include "combine.h"
#include "workspace.h"

/* Squared sine of the angle below which a row is taken as dependent on the others. */
#define DEPENDENT 1e-13
/* Below this it is found by projection, as the difference of two numbers near 1 is too coarse. */
#define DOUBTFUL 1e-9
/* Least violation that counts: of a row scaled to norm 1, and from the rounding of its value. */
#define VIOLATED 1e-10
#define ROUNDING 4e-15
/* Share of the largest violation from which on a row enters together with it. */
#define BULK 0.5

enum { MAX_ITERATIONS = 100 + 10 * N_ROWS, REFINEMENTS = 2, WARM_ROUNDS = 5, MAX_REJECTED = 2, NONE = -1, ITSELF = -2 };

static active_row row_at_bound(const gtmr_controller *c, int row, double side)
{
    const double scale = c->inverse_norm[row];
    const int softened = row % STAGE_ROWS == CLEARANCE;
    const active_row at = {
        row, 0, side, scale, softened ? c->parameters.slack_l1 / scale : HUGE_VAL, 0.0,
    };
    return at;
}

/* What a soft row adds to the diagonal of the Gram matrix: slack per multiplier. */
static double compliance(const gtmr_controller *c, const active_row *a)
{
    return a->soft ? a->scale * a->scale / (2.0 * c->parameters.slack_l2) : 0.0;
}

static double along(const gtmr_controller *c, const active_row *a, const double *v)
{
    return a->side * a->scale * dot(c->rows[a->row], v, row_length(a->row));
}

static void add_row(const gtmr_controller *c, const active_row *a, double factor, double *v)
{
    add_scaled(v, factor * a->side * a->scale, c->rows[a->row], row_length(a->row));
}

static double gram(const gtmr_controller *c, const active_row *a, const active_row *b)
{
    const int length = row_length(a->row < b->row ? a->row : b->row);
    return a->side * a->scale * b->side * b->scale *
           dot(c->rows[a->row], c->rows[b->row], length);
}

/* Solve L y = y; what lies behind the end of y is overwritten. */
static void forward(const working_set *set, double *y)
{
    for (int j = 0; j < set->count; ++j) {
        const double known = y[j] * set->inverse_diagonal[j];
        const double *column = set->factor[j];
        for (int i = j / VEC * VEC; i < set->count; i += VEC) {
            store(y + i, load(y + i) - known * load(column + i));
        }
        y[j] = known;
    }
}

/* Solve L' y = y. */
static void backward(const working_set *set, double *y)
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
        backward(set, by);
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
        forward(set, by);
    }
    return dot(rest, rest, LD_V) + own;
}

/*
 * Extend the factor by a row; 0 if it depends on the others, or may, and is not `needed`. w gets
 * L^-1 times its Gram row.
 */
static int append(gtmr_controller *c, const active_row *row, int needed, double *w)
{
    working_set *set = &c->active;
    const int n = set->count;
    const double own = compliance(c, row);
    double diagonal = 1.0 + own;
    for (int i = 0; i < n; ++i) {
        w[i] = gram(c, &set->member[i], row);
    }
    forward(set, w);
    for (int i = 0; i < n; ++i) {
        diagonal -= w[i] * w[i];
    }
    if (diagonal < DOUBTFUL * (1.0 + own)) {
        diagonal = needed ? squared_sine(c, row, w) + own : 0.0;
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
static active_row take_out(gtmr_controller *c, int at)
{
    working_set *set = &c->active;
    const active_row out = set->member[at];
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
    c->in_set[out.row] = 0;
    return out;
}

/* How far a multiplier can go along a direction until it reaches 0 or its cap. */
static double room(const active_row *a, double direction)
{
    if (direction < 0.0) {
        const double step = ((a->soft ? a->cap : 0.0) - a->lambda) / direction;
        return step > 0.0 ? step : 0.0;
    }
    if (direction > 0.0 && !a->soft) {
        return (a->cap - a->lambda) / direction;
    }
    return HUGE_VAL;
}

/* How far all multipliers can go, `limit` at most, and which one stops them. */
static double longest_step(const working_set *set, const double *direction, double limit,
                           int *blocking)
{
    double longest = limit;
    for (int i = 0; i < set->count; ++i) {
        const double step = room(&set->member[i], direction[i]);
        if (step < longest) {
            longest = step;
            *blocking = i;
        }
    }
    return longest;
}

static void advance(working_set *set, const double *direction, double step)
{
    for (int i = 0; i < set->count; ++i) {
        set->member[i].lambda += step * direction[i];
    }
}

/*
 * Gradient of the dual objective with respect to a row's multiplier: by how much the row exceeds
 * its bound, less what its slack takes up.
 */
static double excess(const gtmr_controller *c, const active_row *a, const double *v)
{
    const double bound = a->side > 0.0 ? c->upper[a->row] : c->lower[a->row];
    const double slack = a->soft ? compliance(c, a) * (a->lambda - a->cap) : 0.0;
    return a->side * a->scale * (c->value[a->row] - bound) + along(c, a, v) - slack;
}

/* v of the multipliers. */
static void minimiser(const gtmr_controller *c, double *v)
{
    memset(v, 0, LD_V * sizeof(double));
    for (int i = 0; i < c->active.count; ++i) {
        add_row(c, &c->active.member[i], -c->active.member[i].lambda, v);
    }
}

/*
 * Change of the set's multipliers, per unit of that of a dependent row, that leaves v alone; w as
 * from `append`. Returns the sign of the change that raises the dual objective.
 */
static double null_direction(const gtmr_controller *c, const active_row *row, double *w)
{
    const working_set *set = &c->active;
    double v[LD_V];
    minimiser(c, v);
    add_row(c, row, -row->lambda, v);
    double slope = excess(c, row, v);
    backward(set, w);
    for (int i = 0; i < set->count; ++i) {
        /* A soft row is independent of all others. */
        w[i] = set->member[i].soft ? 0.0 : -w[i];
        slope += w[i] * excess(c, &set->member[i], v);
    }
    return slope < 0.0 ? -1.0 : 1.0;
}

/*
 * Let a row enter; while it depends on others, multipliers go along the null direction until one
 * of them makes way. Returns 0 if none does: then the hard rows contradict each other.
 */
static int enter(gtmr_controller *c, active_row row)
{
    working_set *set = &c->active;
    double direction[LD_ACTIVE], w[LD_ACTIVE];
    while (!append(c, &row, 1, direction)) {
        int blocking = ITSELF;
        const double sign = null_direction(c, &row, direction);
        for (int i = 0; i < set->count; ++i) {
            direction[i] *= sign;
        }
        const double step = longest_step(set, direction, room(&row, sign), &blocking);
        if (step == HUGE_VAL) {
            return 0;
        }
        advance(set, direction, step);
        row.lambda += sign * step;
        if (blocking == ITSELF) {
            if (sign < 0.0) {
                return 1;
            }
            row.soft = 1;
            row.lambda = row.cap;
        } else {
            const int leaves = direction[blocking] < 0.0;
            active_row other = take_out(c, blocking);
            other.soft = 1;
            other.lambda = other.cap;
            if (!leaves && !append(c, &other, 1, w)) {
                return 0;
            }
        }
    }
    return 1;
}

/* Let go of a row whose multiplier reached 0, or change sides at the cap. */
static int pass_limit(gtmr_controller *c, int blocking, double direction)
{
    active_row row = take_out(c, blocking);
    if (direction < 0.0 && !row.soft) {
        return 1;
    }
    row.lambda = row.cap;
    row.soft = !row.soft;
    return enter(c, row);
}

/* Go to where the rows of the working set hold with equality: add the change to v. */
static void correction(const gtmr_controller *c, double *change, const double *v)
{
    for (int i = 0; i < c->active.count; ++i) {
        change[i] = excess(c, &c->active.member[i], v);
    }
    forward(&c->active, change);
    backward(&c->active, change);
}

/*
 * Let go of all rows without a multiplier that would need one below 0; returns how many. v stays
 * as it is, and of the rows that have just entered at least one stays, as together they ascend.
 */
static int drop_idle(gtmr_controller *c, const double *direction)
{
    int dropped = 0;
    for (int i = c->active.count - 1; i >= 0; --i) {
        if (c->active.member[i].lambda == 0.0 && direction[i] < 0.0) {
            take_out(c, i);
            ++dropped;
        }
    }
    return dropped;
}

/* Iterative refinement, as the Gram matrix squares the condition of the rows. */
static void refine(gtmr_controller *c)
{
    double change[LD_ACTIVE];
    for (int pass = 0; pass < REFINEMENTS; ++pass) {
        correction(c, change, c->v);
        advance(&c->active, change, 1.0);
        minimiser(c, c->v);
    }
}

/* By how much a row outside the working set is violated, scaled; negative below its bounds. */
static double violation_of(const gtmr_controller *c, int row, double change)
{
    const double value = c->value[row] + change;
    const double above = value - c->upper[row], below = c->lower[row] - value;
    const double worse =
        ((above > below ? above : below) - ROUNDING) * c->inverse_norm[row];
    if (c->in_set[row] || !(worse > VIOLATED)) {
        return 0.0;
    }
    return above > below ? worse : -worse;
}

/* Violations of all rows; returns the row that is violated most, NONE if all hold. */
static int violations(const gtmr_controller *c, double *violation)
{
    double speed[N_U] = {0.0}, most = 0.0;
    int worst = NONE;
    for (int stage = 0; stage < STAGES; ++stage) {
        for (int j = 0; j < STAGE_ROWS; ++j) {
            const int row = row_of(stage, j);
            double change;
            if (j < N_U || j == CLEARANCE) {
                change = dot(c->rows[row], c->v, row_length(row));
                speed[j % N_U] += j < N_U ? PERIOD_S * change : 0.0;
            } else {
                /* Speeds are sums of inputs: no need to go through their rows. */
                change = speed[j - N_U];
            }
            violation[row] = violation_of(c, row, change);
            if (fabs(violation[row]) > most) {
                most = fabs(violation[row]);
                worst = row;
            }
        }
    }
    return worst;
}

/* Let the worst row enter, and with it those that are nearly as bad and independent. */
static int enter_violated(gtmr_controller *c, const double *violation, int worst)
{
    double w[LD_ACTIVE];
    const double least = BULK * fabs(violation[worst]);
    if (!enter(c, row_at_bound(c, worst, violation[worst] > 0.0 ? 1.0 : -1.0))) {
        return 0;
    }
    int rejected = 0;
    for (int i = 0; i < N_ROWS && rejected < MAX_REJECTED; ++i) {
        if (fabs(violation[i]) > least && !c->in_set[i]) {
            const active_row row = row_at_bound(c, i, violation[i] > 0.0 ? 1.0 : -1.0);
            rejected += !append(c, &row, 0, w);
        }
    }
    return 1;
}

/* Take up the multipliers of the last QP. */
static void take_up(gtmr_controller *c)
{
    double w[LD_ACTIVE];
    c->active.count = 0;
    memset(c->in_set, 0, sizeof c->in_set);
    for (int i = 0; i < N_ROWS; ++i) {
        const double multiplier = c->multiplier[i];
        const double bound = multiplier > 0.0 ? c->upper[i] : c->lower[i];
        if (multiplier == 0.0 || fabs(bound) == HUGE_VAL || c->inverse_norm[i] == 0.0) {
            continue;
        }
        active_row row = row_at_bound(c, i, multiplier > 0.0 ? 1.0 : -1.0);
        row.lambda = fabs(multiplier) / row.scale;
        row.soft = row.lambda > row.cap;
        append(c, &row, 0, w);
    }
}

/*
 * Begin with the working set of the last QP, less what does not belong in it any more. Here all
 * rows that would need a multiplier below 0 go at once: it is only a start.
 */
static void warm_start(gtmr_controller *c)
{
    working_set *set = &c->active;
    double direction[LD_ACTIVE];
    take_up(c);
    for (int round = 0; round < WARM_ROUNDS; ++round) {
        const int before = set->count;
        minimiser(c, c->v);
        correction(c, direction, c->v);
        for (int i = before - 1; i >= 0; --i) {
            active_row *a = &set->member[i];
            const double least = a->soft ? a->cap : 0.0, most = a->soft ? HUGE_VAL : a->cap;
            const double lambda = a->lambda + direction[i];
            a->lambda = lambda < least ? least : lambda > most ? most : lambda;
            if (lambda < 0.0) {
                take_out(c, i);
            }
        }
        if (set->count == before) {
            return;
        }
    }
}

static void keep_multipliers(gtmr_controller *c)
{
    for (int i = 0; i < c->active.count; ++i) {
        const active_row *a = &c->active.member[i];
        c->last.multiplier[a->row] = a->side * a->scale * a->lambda;
    }
}

int active_set_solve(gtmr_controller *c)
{
    double direction[LD_ACTIVE], violation[N_ROWS];
    warm_start(c);
    minimiser(c, c->v);
    for (int iteration = 0; iteration < MAX_ITERATIONS; ++iteration) {
        int blocking = NONE;
        correction(c, direction, c->v);
        if (drop_idle(c, direction)) {
            continue;
        }
        const double step = longest_step(&c->active, direction, 1.0, &blocking);
        advance(&c->active, direction, step);
        if (blocking != NONE) {
            if (!pass_limit(c, blocking, direction[blocking])) {
                return 1;
            }
            minimiser(c, c->v);
            continue;
        }
        minimiser(c, c->v);
        int worst = violations(c, violation);
        if (worst == NONE) {
            refine(c);
            worst = violations(c, violation);
        }
        if (worst == NONE) {
            keep_multipliers(c);
            return 0;
        }
        if (!enter_violated(c, violation, worst)) {
            return 1;
        }
        minimiser(c, c->v);
    }
    return 1;
}
