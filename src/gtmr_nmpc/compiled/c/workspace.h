// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* The memory of a controller, and its parts that share it. */
#ifndef GTMR_WORKSPACE_H
#define GTMR_WORKSPACE_H

#include "gtmr.h"
#include "problem.h"
#include "vec.h"

enum {
    N_U = ROTORS,     /* inputs */
    N_X = BODY + N_U, /* states; the last N_U integrate the inputs */
    N_XU = N_X + N_U,
    /* First states of a kind. Positions go through a stage unchanged; rates depend on no other. */
    ETA = 3,
    OMEGA = 9,
    N_V = STAGES * N_U, /* all inputs of the horizon */
    N_THETA = 9,        /* force that stays, force that decays, torque */
    N_DISTURBED = 6,    /* force, torque */
    LD_BODY = PADDED(BODY),
    LD_X = PADDED(N_X),
    LD_U = PADDED(N_U),
    LD_XU = PADDED(N_XU),
    LD_ZETA = PADDED(N_ZETA),
    LD_V = PADDED(N_V),
    /* Rows of inequalities per stage: inputs, then rotor speeds and clearance one stage on. */
    STAGE_ROWS = 2 * N_U + 1,
    CLEARANCE = 2 * N_U,
    N_ROWS = STAGES * STAGE_ROWS,
    /* Independent rows at most, plus one soft row a stage, plus the row about to enter. */
    MAX_ACTIVE = N_V + STAGES + 1,
    LD_ACTIVE = PADDED(MAX_ACTIVE + 3), /* whole registers, and whole tiles of four */
    /* Parts of a plan as a caller gets it, and its length. */
    PLAN_X = (STAGES + 1) * N_X,
    PLAN_U = STAGES * N_U,
    PLAN_CHANNELS = (STAGES + 1) * N_ZETA,
    PLAN_SETPOINTS = PLAN_X + PLAN_U + PLAN_CHANNELS + 3 * (STAGES + 1),
    PLAN_NOTES = PLAN_SETPOINTS + (STAGES + 1) * N_U,
    PLAN_LENGTH = PLAN_NOTES + 3
};

/* One shooting interval, linearised. */
typedef struct {
    ALIGNED double jacobian[N_H][LD_XU]; /* [A B], rows of the body, then of the acceleration */
    double dF_dzeta[BODY][LD_ZETA];
    double defect[LD_X];
    double acceleration[3];
} interval;

/*
 * How an input is determined: freely, or at a bound of its own or of the rotor's next speed. Where
 * inputs at their bounds lead to the very bound of a speed, a corner, the last input before them
 * is what leads there: TO_CORNER. Negative: at lower bounds, or to one of a speed.
 */
enum { FREE = 0, AT_INPUT = 1, AT_SPEED = 2, TO_CORNER = 3 };

/* Stages between two of which the cost to go is kept. */
enum { CHECKPOINT = 8 };

/* The law of a stage, of the Riccati recursion; which inputs are held goes for it and those after. */
typedef struct {
    ALIGNED double Z[N_U][LD_X]; /* of free inputs: du = C' (v - z - Z dx) */
    double z[LD_U];
    double whitening[N_U][LD_U]; /* C = L^-1, with L L' the Hessian of du */
    double offset[LD_U];         /* of held inputs: du = offset + slope dxi of the rotor */
    double slope[N_U];
} law;

/* Rows of all inputs of the Hessian of stage cost plus cost to go, and of its gradient at 0. */
typedef struct {
    ALIGNED double Q[N_U][LD_XU];
    double q[N_U];
} input_cost;

/*
 * Cost to go, x' P x / 2 + p' x. P is symmetric: computed are the registers up to the diagonal;
 * `mirror` adds what is read beyond them, inside the blocks of the body and of the rotors.
 */
typedef struct {
    double P[N_X][LD_X];
    double p[LD_X];
} value_function;

/* The clearance constraint at a stage. */
typedef struct {
    double gradient[CLEARANCE_STATES]; /* J_yx: of y in p_x, p_y, then in the others */
    double residual;    /* y + alpha along the iterate [m] */
    double alpha_p;
    double alpha_g;
    double by_channel[N_ZETA];
    double signs[N_ZETA]; /* sign(Pi_y) w_bar, held while alpha_p is differentiated */
} clearance;

/* An inequality that holds with equality, scaled to norm 1. */
typedef struct {
    int row;
    int soft;      /* whether its multiplier is above the cap: a slack is open */
    double side;   /* +1 at the upper bound, -1 at the lower */
    double scale;  /* 1 / norm of the row */
    double cap;    /* multiplier above which a slack opens, infinite if never */
    double lambda; /* multiplier, not negative */
    double excess; /* of its value over its bound, less what its slack takes up */
} active_row;

/*
 * The working set and the Cholesky factor of the Gram matrix of its rows, column by column; above
 * the diagonal are zeros, so that every column can be taken from the start of a register.
 */
typedef struct {
    int count;
    int settled; /* so many rows, from the first on, hold with equality */
    active_row member[MAX_ACTIVE];
    ALIGNED double factor[MAX_ACTIVE][LD_ACTIVE];
    double inverse_diagonal[MAX_ACTIVE];
} working_set;

/* A solution, kept to start the next step from. */
typedef struct {
    double x[STAGES + 1][N_X];
    double u[STAGES][N_U];
    double multiplier[N_ROWS]; /* of the inequalities, negative at a lower bound */
} plan;

/* What the observer believes. */
typedef struct {
    int begun;
    double x[N_X];
    double theta[N_THETA];
} observer;

/* A plan that was sent. */
typedef struct {
    double start_s;
    double u[STAGES][N_U];
    double setpoints[STAGES + 1][N_U];
} sent_plan;

/* What passes from step to step. */
typedef struct {
    double margin_scale; /* of the mode: how much of eq. (12) and (13) applies */
    double offset_free;  /* and how much of offset_free */
    const double *margins; /* the table */
    int margin_rows;
    int is_prepared; /* for prepared_s */
    double prepared_s;
    double clock_s; /* when preparation began, and how long it took */
    double prepare_s;
    int begun; /* whether there was a step; from last_s on its plan acts */
    double last_s;
    int is_a_start; /* whether that plan can be the next iterate */
    int observed;   /* whether there was a measurement, at observed_s */
    double observed_s;
    int observed_steps;
    double theta[N_THETA]; /* as it will be when the next plan begins */
    /* The plans that were sent recently, the oldest at `oldest`, then around. */
    int sent_count;
    int oldest;
    sent_plan sent[SENT_PLANS];
} progress;

struct gtmr_controller {
    gtmr_parameters parameters;
    observer observer;
    progress progress;
    int disturbed;                           /* whether theta acts in the model */
    double disturbance[STAGES][N_DISTURBED]; /* force and torque of every stage */
    double margin_scale;
    int is_tightened; /* by other margins, told as these alpha_p and alpha_g */
    double told[2][STAGES + 1];
    plan last;               /* what the last step returned */
    double x[STAGES + 1][N_X]; /* the iterate */
    double u[STAGES][N_U];
    int end_is_open;           /* whether x[STAGES] is to follow from the stage before it */
    double multiplier[N_ROWS]; /* where the active set starts from */
    interval intervals[STAGES];
    law laws[STAGES];      /* with all inputs free */
    law held_laws[STAGES]; /* of the first `held_stages`, with some held */
    input_cost input_costs[STAGES];
    int held_stages;
    signed char held[STAGES][N_U];
    int corner[STAGES][N_U];        /* to which stage's, where held TO_CORNER */
    signed char swaps[STAGES][N_U]; /* between AT_INPUT and AT_SPEED */
    ALIGNED value_function to_go[STAGES]; /* of held_laws */
    /* Of laws, at multiples of CHECKPOINT. */
    ALIGNED value_function checkpoints[(STAGES - 1) / CHECKPOINT + 1];
    clearance clearances[STAGES + 1];
    double Pi[STAGES + 1][BODY][LD_ZETA]; /* eq. (8); rotor speeds do not depend on zeta */
    ALIGNED double cost_gradient[STAGES + 1][LD_XU]; /* half of it, by the state; zeros behind */
    ALIGNED double step[STAGES + 1][LD_XU]; /* [dx du], the step of the iterate */

    /* The QP in v, where its cost is |v|^2 / 2: rows, values at v = 0 and bounds. */
    ALIGNED double rows[N_ROWS][LD_V];
    double inverse_norm[N_ROWS]; /* 0 for a row that is left out */
    int only_clearances;
    /* What the inputs do to the clearances that count. */
    ALIGNED double by_input[STAGES][LD_V];
    int counts[STAGES]; /* whether the clearance one stage on has a row, where only they have */
    double value[N_ROWS];
    double lower[N_ROWS];
    double upper[N_ROWS];
    ALIGNED double v[LD_V];
    int in_set[N_ROWS];
    int passes;  /* of the active set in this step */
    int guesses; /* of what is held, in this step; -1 if none was right */
    working_set active;

    /* Rows of one stage after the other, once they were asked for. */
    int has_margin_gradients;
    ALIGNED double margin_gradient[(STAGES + 1) * (STAGES + 2) / 2][LD_XU];

    vec lanes_in[MODEL_LANES_IN];
    vec lanes_out[MODEL_LANES_OUT];
};

/* linearise.c */
void gtmr_linearise(gtmr_controller *c, double t);

/* F with theta, for the first stage or stages of a register: what is in lanes_in, with the
 * disturbances of a stage. */
void gtmr_evaluate_model(gtmr_controller *c);
void gtmr_put_disturbance(gtmr_controller *c, int stage, int which);

/* margins.c, margin_gradients.c */

/* In which states J_yx has its entries. */
static const int CLEARANCE_STATE[CLEARANCE_STATES] = {CLEARANCE_STATE_LIST};

/* y and J_yx at a state. */
void gtmr_clearance_at(const gtmr_parameters *parameters, const double *x, double *constraint);
void gtmr_clearance_along_iterate(gtmr_controller *c);
void gtmr_margin_change_along_step(gtmr_controller *c, double *change);
/* Gradients of all alpha_p, unless they are known; that of a stage, in [x u] of the stages 0 to its
 * own, u of the last being zero. */
void gtmr_find_margin_gradients(gtmr_controller *c);
const double (*gtmr_margin_gradient(const gtmr_controller *c, int stage))[LD_XU];

/* riccati.c: the laws of all stages; with inputs held, if what is held changed up to a stage. */
void gtmr_riccati_factorise(gtmr_controller *c);
void gtmr_riccati_factorise_held(gtmr_controller *c, int last_change);
void gtmr_riccati_gain(const law *at, double K[N_U][LD_X]); /* of du = K dx + k + C' v */

/* rollout.c: the step that the laws make; v may be NULL. */
void gtmr_rollout(gtmr_controller *c, const double *dx0, const double *v);
/* The same with all inputs free, but cut to what the bounds of rotors leave. */
void gtmr_rollout_within(gtmr_controller *c, const double *dx0, const double *v);
/* The input of a stage, whose part of v it takes, and the state after it. */
void gtmr_law_input(const law *at, const double *dx, const double *v, double *du);
void gtmr_advance(const interval *at, const double *now, double *next);

/* condense.c: the rows of the inequalities in v; those of the clearances that count alone, with
 * their values at v = 0, the others being as good as absent. */
void gtmr_condense(gtmr_controller *c, const double *dx0);
void gtmr_condense_clearances(gtmr_controller *c, const double *dx0);
/* What the last multipliers of the clearances add to the gradients of the inputs. */
void gtmr_clearance_forces(const gtmr_controller *c, double forces[STAGES][N_U]);

/* pivoting.c: the whole QP by its structure; 0 if it does not settle, after `guesses`. */
int gtmr_pivot(gtmr_controller *c, const double *dx0);

/* feedback.c: the tightened clearances of stages 1 to N after the step [m]. */
void gtmr_clearances_along_step(gtmr_controller *c, double *along);
/* Let those that are broken count; whether one did not. */
int gtmr_count_broken(gtmr_controller *c, const double *along);

/* working_set.c */

/* What a soft row adds to the diagonal of the Gram matrix: slack per multiplier. */
double gtmr_compliance(const gtmr_controller *c, const active_row *a);

/* Extend the factor by a row; 0 if it depends on the others. w: L^-1 times its Gram row. */
int gtmr_working_set_append(gtmr_controller *c, const active_row *row, double *w);
active_row gtmr_working_set_remove(gtmr_controller *c, int at);

/* Products of the set's rows, scaled and on their sides, with v, of which `length` count. */
void gtmr_working_set_along(const gtmr_controller *c, const double *v, int length, double *out);

/* Add a combination of the set's rows, scaled and on their sides. */
void gtmr_working_set_combine(const gtmr_controller *c, const double *by, double *v);

/* Solve L y = y and L' y = y for the factor L; what is behind the end of y is overwritten. */
void gtmr_working_set_forward(const working_set *set, double *y);
void gtmr_working_set_backward(const working_set *set, double *y);

/* sent.c */

/* Remember a plan that acts from start_s on, and what acted at oldest_s. */
void gtmr_sent_add(gtmr_controller *c, double start_s, double oldest_s, const double *setpoints);

/* Predict a state from its stamp t to now, with the plans that were sent. */
void gtmr_sent_ahead(gtmr_controller *c, double *x, double t, double now);

/* Speed setpoints that make lagging rotors follow the last plan. */
void gtmr_setpoints(const gtmr_controller *c, double setpoints[][N_U]);

/* step.c: note that preparation is done. */
void gtmr_note_prepared(gtmr_controller *c);

/* violations.c: by how much rows outside the working set are violated, scaled, negative below their
 * bounds; of the clearances alone if only they count. Returns the worst row, -1 if all hold. */
int gtmr_violations(const gtmr_controller *c, double *violation);

/* active_set.c: 0 if solved; otherwise v is that of the multipliers so far, and breaks rows. */
int gtmr_active_set_solve(gtmr_controller *c);

static inline int is_robust(const gtmr_controller *c)
{
    return c->margin_scale > 0.0;
}

static inline int with_margin_gradient(const gtmr_controller *c)
{
    return is_robust(c) && c->parameters.with_margin_gradient != 0.0;
}

static inline const law *law_of(const gtmr_controller *c, int stage)
{
    return stage < c->held_stages ? &c->held_laws[stage] : &c->laws[stage];
}

/* Whether an input follows from its rotor's speed. */
static inline int has_slopes(const law *at)
{
    int any = 0;
    for (int r = 0; r < N_U; ++r) {
        any |= at->slope[r] != 0.0;
    }
    return any;
}

/* Rows that count: from the first on, so many apart. */
static inline int first_row(const gtmr_controller *c)
{
    return c->only_clearances ? CLEARANCE : 0;
}

static inline int row_stride(const gtmr_controller *c)
{
    return c->only_clearances ? STAGE_ROWS : 1;
}

static inline int row_of(int stage, int which)
{
    return stage * STAGE_ROWS + which;
}

/* Entries of a row of interval k that may differ from zero, filled up to registers. */
static inline int row_length(int row)
{
    return PADDED((row / STAGE_ROWS + 1) * N_U);
}

#endif
