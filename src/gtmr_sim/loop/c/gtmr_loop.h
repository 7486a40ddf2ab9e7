// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/*
 * A simulated flight between two instants: the plant, its world and gusts, and the plan it plays.
 *
 * The same as gtmr_sim/loop/reference.py, to the last digit. No heap, no globals: all memory is
 * one gtmr_loop and what it points to, which the caller owns. Random numbers are drawn by the
 * caller, some rows ahead.
 *
 * Times are whole plant steps where their name has no unit. World ENU; m, rad, s, N, rotor speeds
 * in Hz. All fields are of eight bytes, so that callers in other languages find them.
 */
#ifndef GTMR_LOOP_H
#define GTMR_LOOP_H

#include <stdint.h>

/* Moves a plant's memory on by some steps; what is not zero ends the flight. */
typedef int (*gtmr_loop_plant)(double *memory, int steps);

/* gtmr_guard_step of gtmr_guard.h. */
typedef int (*gtmr_loop_guard)(void *guard, double dt_s, const double *position,
                               const double *attitude, const double *rotor_speeds,
                               const double *u_due, double overdue_s, double age_s, double *u);

/* What is drawn ahead, a row at a time. */
typedef struct {
    const double *rows;
    int64_t count, used;
} gtmr_loop_ahead;

typedef enum {
    GTMR_LOOP_NO_PLAN = 0, /* none has come */
    GTMR_LOOP_UNUSABLE = 1, /* it cannot be sent to the rotors */
    GTMR_LOOP_USABLE = 2
} gtmr_loop_kind;

/* Commands for the rotors from a plant step on, a row each plan step. */
typedef struct {
    int64_t acts;  /* from when on it is played */
    int64_t start; /* when its first row is due, perhaps before that */
    int64_t kind;
    int64_t n, has_setpoints;
    double *u;            /* rotor accelerations [Hz/s], (n, n_rotors) */
    double *setpoints_hz; /* at the plan steps, (n + 1, n_rotors) */
} gtmr_loop_plan;

typedef struct {
    /* Time now, and the lengths of time that it is cut into. */
    int64_t step, plan_step, hold, sample, watch, act;
    double step_s;
    int64_t n_rotors;
    int64_t due; /* of this instant, not done yet: bits of gtmr_loop.c */

    /* The plant. x begins its memory; the others lie in it. */
    gtmr_loop_plant advance;
    double *x, *setpoints_hz, *u, *w_g, *air_m_s;
    int64_t has_motors;
    double min_rotor_speed_hz, max_rotor_speed_hz;

    /* The plan in play, and after it those to come, in the order in which they act. */
    gtmr_loop_plan *plans;
    int64_t plans_room, plan_rows_room, coming;

    /* The guard, none if NULL. */
    gtmr_loop_guard guard;
    void *guard_memory;
    double *guard_u, *guard_due, *guard_sight; /* (n_rotors,), (n_rotors,), (n_x,) */
    int64_t cause, looked, seen, guarded;

    /* Gusts: forces, world frame, or amounts towards the tower; and the one that acts. */
    gtmr_loop_ahead gust;
    int64_t gust_is_inward;
    double gust_n[3];

    /* Wind, as in gtmr_sim/worlds/wind.py. */
    int64_t has_wind;
    double far_m_s[3], along[2];
    double reference_height_m, profile_exponent, tower_radius_m, tower_drag_coefficient;
    int64_t flow_around_tower, wake, is_turbulent;
    gtmr_loop_ahead turbulence;

    /* Odometry, as in gtmr_sim/worlds/sensor.py; of numbers a row has 12 for the state, 3 for the
     * bias, one for the age and one for the loss. */
    int64_t has_sensor;
    gtmr_loop_ahead numbers;
    double noise_std[12], bias_m[3], bias_kept, bias_spread_m;
    double rotor_quantum_hz, delay_s, jitter_s, dropout;
    /* On their way: when they arrive, when they were made, and the states, (way_room, n_x). */
    int64_t way_room, way;
    int64_t *way_arrives, *way_made;
    double *way_x;
    int64_t newest_made; /* negative while there is none */
    double *newest_x;
} gtmr_loop;

typedef enum {
    GTMR_LOOP_DONE = 0,
    /* The caller has to draw more rows, and call again. */
    GTMR_LOOP_NEEDS_GUST = 1,
    GTMR_LOOP_NEEDS_TURBULENCE = 2,
    GTMR_LOOP_NEEDS_NUMBERS = 3,
    GTMR_LOOP_PLANT_ENDED = 4
} gtmr_loop_status;

/* sizeof(gtmr_loop), for callers in other languages. */
int64_t gtmr_loop_size(void);

/* Before a flight, or with other gusts or wind in it: draw those of this instant anew. */
void gtmr_loop_draw(gtmr_loop *loop);

/* Measure the state of this instant. */
void gtmr_loop_measure(gtmr_loop *loop);

/* Fly on until a plant step; called again after it asked for rows it goes on where it was. */
gtmr_loop_status gtmr_loop_advance(gtmr_loop *loop, int64_t end);

/*
 * Take over a plan of n rows, to be played from acts on; setpoints_hz may be NULL. What was to
 * come then or later is forgotten. Zero if there is no room for it, and nothing is done.
 */
int gtmr_loop_play(gtmr_loop *loop, int64_t start, int64_t acts, gtmr_loop_kind kind, int64_t n,
                   const double *u, const double *setpoints_hz);

/* When the newest measurement that has arrived was made, its state in newest_x; negative if none
 * has. Only with a sensor. */
int64_t gtmr_loop_newest(gtmr_loop *loop);

#endif
