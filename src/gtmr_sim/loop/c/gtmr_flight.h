// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/*
 * A closed loop: a flight, and a controller in C that steps it every plan step.
 *
 * The same as the loop of gtmr_sim/flying/stepwise.py, to the last digit but for solve times.
 */
#ifndef GTMR_FLIGHT_H
#define GTMR_FLIGHT_H

#include "gtmr_loop.h"

/*
 * Plans from a measured state x, of the stamp t, what acts from now on [s]; writes its plan and
 * returns a status, negative if it refuses x.
 */
typedef int (*gtmr_flight_controller)(void *controller, double t, const double *x, double now,
                                      double *plan);

typedef enum {
    GTMR_FLIGHT_DECIDES = 0, /* the controller is due, if a measurement has arrived */
    GTMR_FLIGHT_COMMANDS = 1, /* its plan is to be played */
    GTMR_FLIGHT_FLIES = 2
} gtmr_flight_phase;

typedef struct {
    gtmr_loop *loop;
    gtmr_flight_controller controller;
    void *controller_memory;
    double delay_s, transport_s; /* of measurements, of commands */
    int64_t tells_now; /* whether the plan acts when a measurement is as old as it gets */
    int64_t failed; /* the status of a step that failed */

    /* What it writes: the whole; and where there are, with N stages, accelerations (N, n_rotors),
     * setpoints (N + 1, n_rotors), and of the stages (N + 1) margins and slack. */
    int64_t stages;
    double *plan;
    const double *u, *setpoints_hz, *alpha_p, *alpha_g, *slack;

    /* The step in progress. */
    int64_t k, phase, handed_out;
    double stamp_s, now_s;
    double *x; /* the state that the controller is given, (n_x,) */

    /* A row each step. */
    double *log_x, *log_measured, *log_u, *log_gust_n, *log_air_m_s;
    double *log_alpha_p, *log_alpha_g, *log_slack, *log_solve_ms;
    uint8_t *log_failed, *log_guard;
} gtmr_flight;

/* Beyond those of gtmr_loop_status. */
enum {
    GTMR_FLIGHT_NEEDS_ROOM = 5, /* for another plan */
    GTMR_FLIGHT_REFUSED = 6, /* the controller did, the state in x */
    GTMR_FLIGHT_NOT_FINITE = 7 /* its plan is not */
};

/* sizeof(gtmr_flight). */
int64_t gtmr_flight_size(void);

/* Fly on until a step; called again after it asked for something it goes on where it was. */
int gtmr_flight_run(gtmr_flight *flight, int64_t until);

#endif
