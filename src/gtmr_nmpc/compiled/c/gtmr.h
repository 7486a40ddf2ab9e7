// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/*
 * The controller of one problem: nominal or robust NMPC in real-time iteration.
 *
 * No heap, no globals: all memory is one block that the caller owns, so several controllers run
 * side by side, one thread each. What the linker sees begins with gtmr_; two vehicles make two
 * libraries. Stack: 64 kB are enough for 20 stages and 6 rotors if optimised (-O2, -O3), in
 * proportion to stages for more; most of it is condense.c's.
 *
 * Units as in the paper: m, rad, m/s, rad/s, rotor speeds in Hz.
 */
#ifndef GTMR_H
#define GTMR_H

#include <stddef.h>

/* What may change without compiling again; the vehicle, T_s and N may not. */
typedef struct {
    /* The tower, and the numbers of the reference: of a helix its offset d_ref, speed, climb,
     * start height and start angle, in m, m/s and rad. */
    double tower_radius_m;
    double min_clearance_m;
    double reference[16];
    /* Rotor limits. */
    double min_rotor_speed_hz;
    double max_rotor_speed_hz;
    double max_rotor_acceleration_hz_s;
    /* Diagonals of Q, Q_u and Q_f, eq. (6); Q in the order p, v, acceleration, eta, omega. */
    double stage_weights[15];
    double input_weight;
    double terminal_weights[3];
    /* Margins: half-widths of the box of zeta, eps_s, and alpha_g,N / N^2 of eq. (13). */
    double half_widths[9];
    double eps_s_m;
    double gust_m;
    /* Penalty l1 s + l2 s^2 on the slack of the clearance. */
    double slack_l1;
    double slack_l2;
    /* Whether alpha_p enters the QP with its gradient: 0 or 1. */
    double with_margin_gradient;
    /* Observer: gains of [p v b g] by [p v], and of [eta omega tau] by [eta omega] on each axis, row
     * by row; bounds of theta; what is left of g after T_s, and its correlation time. */
    double translation_gains[4 * 2];
    double rotation_gains[3 * 3 * 2];
    double theta_bounds[9];
    double gust_decay;
    double gust_time_s;
    /* Time constant of rotors behind their speed setpoints, 0 for rotors that take accelerations;
     * how old a state is when the command acts, of which it counts whether it is 0. */
    double motor_lag_s;
    double delay_s;
} gtmr_parameters;

/*
 * How a step ended. Solved, softened: with the solution of its QP, which in the latter case needs
 * slack. Failed: there are no finite numbers, and the plan is the iterate. Limited: stopped before
 * the solution was found, at the bound on passes or where rounding stood in the way; the plan keeps
 * the limits of the rotors and its slack is told, but there is a better one. Refused: a state that
 * is not finite, or a command that is to act before its state or never; nothing was done.
 */
typedef enum {
    GTMR_REFUSED = -1,
    GTMR_SOLVED = 0,
    GTMR_SOFTENED = 1,
    GTMR_FAILED = 2,
    GTMR_LIMITED = 3
} gtmr_status;

typedef struct gtmr_controller gtmr_controller;

/* Bytes of the memory of a controller, to be aligned to 64. */
size_t gtmr_size(void);

/* Entries of a plan, as gtmr_step and gtmr_feedback write it. */
size_t gtmr_plan_length(void);

/* Make a controller in zeroed or used memory. */
gtmr_controller *gtmr_create(void *memory, const gtmr_parameters *parameters);

/* Take over other parameters; the warm start is kept. */
void gtmr_reconfigure(gtmr_controller *controller, const gtmr_parameters *parameters);

/*
 * A step as a whole: warm or cold start, margins, observer, prediction, plan.
 *
 * t: stamp of the measured state x (12+N_p) [s], yaw of any number of turns. now: time from which
 * the command acts and the plan begins, t or later [s]; the state is predicted up to it with the
 * plans of the steps before.
 *
 * plan: x (N+1, 12+N_p), u (N, N_p), terms of alpha_p (N+1, 9), alpha_p (N+1), alpha_g (N+1),
 * slack (N+1), setpoints of the rotors [Hz] with the lead for their lag (N+1, N_p), one after the
 * other. Then how many steps ago disturbances began to be estimated when margins were chosen, and
 * the times that gtmr_begin and gtmr_finish took [s], 0 where POSIX clocks are not declared.
 */
gtmr_status gtmr_step(gtmr_controller *controller, double t, const double *x, double now,
                      double *plan);

/*
 * Choose the mode, 0 to 1 each: margins of eq. (12) and (13), and the mode offset_free, whose
 * weights are parameters. Nominal is (0, 0), as at the start, robust (1, 0), offset_free (0, 1);
 * what is in between is for a switch without a bump. Without any offset_free the observer forgets.
 */
void gtmr_set_mode(gtmr_controller *controller, double margin_scale, double offset_free);

/*
 * Let gtmr_step tighten by a table instead of eq. (12) and (13): in row k what to tell as alpha_p
 * (N+1) and alpha_g (N+1) [m] of the step k after disturbances began to be estimated, the last row
 * for all after it. The table stays the caller's; none if there are no rows, as at the start.
 */
void gtmr_set_margins(gtmr_controller *controller, const double *table, int rows);

/* Forget the warm start, the plans and what is estimated: the next step is the first. */
void gtmr_reset(gtmr_controller *controller);

/*
 * The two phases of gtmr_step, for margins of one's own in between, or to do the first one before
 * there is a state: x NULL, then nothing is done without a warm start. Done for the same time and
 * still valid, it is not done again.
 *
 * gtmr_begin returns how many steps ago disturbances began to be estimated; -1 if nothing was done.
 */
int gtmr_begin(gtmr_controller *controller, double t, const double *x, double now);
gtmr_status gtmr_finish(gtmr_controller *controller, double t, const double *x, double now,
                        double *plan);

/* Time from which the last plan acts [s]; not a number before the first step. */
double gtmr_last_time(const gtmr_controller *controller);

/* The parts of the above, for steps in an order of one's own. */

/* Make the iterate from a state held over the whole horizon. */
void gtmr_cold(gtmr_controller *controller, const double *x);

/*
 * Make the iterate from the last plan, moved on by whole sampling times, the rotors then holding
 * their speeds. Not from one that failed, whose pitch reaches 90 degrees or whose slack exceeds
 * tower radius and least clearance: it has left the model's range; make a cold one.
 */
void gtmr_warm(gtmr_controller *controller, int steps);

/*
 * Let disturbances act in the model from the next gtmr_warm or gtmr_prepare on.
 *
 * theta: force that stays, force that decays by gust_decay a stage, world frame [N], and torque,
 * body frame [N m], three each; NULL for none, as at the start.
 */
void gtmr_disturb(gtmr_controller *controller, const double *theta);

/*
 * Linearise along the iterate for time t and factorise: all that needs no measurement.
 *
 * margin_scale: 1 in robust mode, 0 in nominal mode, in between after a switch.
 */
void gtmr_prepare(gtmr_controller *controller, double t, double margin_scale);

/*
 * The iterate of the step that was prepared, for margins of one's own: x (N+1, 12+N_p),
 * u (N, N_p), and in robust mode Pi without the rotor speeds (N+1, 12, 9).
 */
void gtmr_iterate(const gtmr_controller *controller, double *x, double *u, double *Pi);

/* Tighten the clearance of stages 0 to N of the step that was prepared by alpha (N+1) [m] instead
 * of eq. (12) and (13); with_margin_gradient has to be 0. The plan then says alpha as alpha_p. */
void gtmr_tighten(gtmr_controller *controller, const double *alpha);

/* Plan from the measured state, its yaw within pi of the iterate's; plan as of gtmr_step. */
gtmr_status gtmr_feedback(gtmr_controller *controller, const double *x, double *plan);

/* How many passes the active set took in the last step, at most the bound GTMR_MAX_PASSES of
 * active_set.c; 0 where no inequality was broken without it. */
int gtmr_passes(const gtmr_controller *controller);

/* How many guesses of what is at the rotors' bounds the last step took, at most GTMR_MAX_GUESSES of
 * pivoting.c; 0 where none was needed, -1 where none was right and the active set took over. */
int gtmr_guesses(const gtmr_controller *controller);

/*
 * The observer, which needs nothing of the above: forget what it knows, take in a measured state
 * dt [s] after the one before, and predict a state by dt while the rotors go to speeds xi.
 *
 * estimate: x (12+N_p), theta (9). Further apart than the horizon, measurements begin anew.
 */
void gtmr_forget(gtmr_controller *controller);
void gtmr_observe(gtmr_controller *controller, const double *measured, double dt,
                  double *estimate);
void gtmr_ahead(const gtmr_controller *controller, const double *x, const double *xi, double dt,
                double *next);

#endif
