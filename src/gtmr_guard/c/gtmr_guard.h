// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/*
 * The guard of one vehicle: the backup at the actuators, independent of the controller.
 *
 * No heap, no globals: all memory is one gtmr_guard that the caller owns. What the linker sees
 * begins with gtmr_guard_. Stack: 2 kB.
 *
 * World ENU, body FLU; m, rad, s, kg, N, rotor speeds in Hz.
 */
#ifndef GTMR_GUARD_H
#define GTMR_GUARD_H

#include <stddef.h>

#include "gtmr_guard_size.h" /* GTMR_GUARD_ROTORS */

typedef struct {
    double inertia_kg_m2[3];
    /* Force and torque per squared rotor speed, and back. */
    double allocation[6][GTMR_GUARD_ROTORS];
    double inverse[GTMR_GUARD_ROTORS][6];
    double mass_kg;
    double min_rotor_speed_hz;
    double max_rotor_speed_hz;
    double max_rotor_acceleration_hz_s;
    /* Bounds of the thrust along the body's z axis, so that torque remains. */
    double min_thrust_n;
    double max_thrust_n;
    double tower_radius_m;
    double min_clearance_m;
    /* When to take charge, where to go, when to hand back: docs/guard.md. */
    double patience_s;
    double max_plan_age_s;
    double retreat_clearance_m;
    double retreat_speed_m_s;
    double max_acceleration_m_s2;
    double stopped_m_s;
    double min_tilt_cosine;
    double max_speed_m_s;
    double max_rate_rad_s;
    double max_command_hz_s;
    double zone_m;
    double zone_time_s;
    double reaction_s;
    double brake_m_s2;
    double handback_s;
    double fresh_s;
    /* Poles of the estimates [rad/s], gains of the law [1/s]. */
    double position_filter_rad_s;
    double attitude_filter_rad_s;
    double position_gain;
    double velocity_gain;
    double attitude_gain;
    double rate_gain;
    double rotor_gain;
} gtmr_guard_parameters;

/* Why it is in charge. */
typedef enum {
    GTMR_GUARD_NONE = 0,
    GTMR_GUARD_UNUSABLE = 1, /* the command is no number, or far beyond the limits */
    GTMR_GUARD_ENDED = 2,    /* the plan is over, or too old */
    GTMR_GUARD_TILT = 3,
    GTMR_GUARD_SPEED = 4,
    GTMR_GUARD_ZONE = 5 /* too close to the tower, and not moving away */
} gtmr_guard_cause;

typedef struct {
    gtmr_guard_parameters is;
    /* Estimates: position, velocity and disturbing acceleration in the world; attitude, body to
     * world; body rate and disturbing angular acceleration in the body. */
    double p[3], v[3], d[3];
    double R[3][3], omega[3], d_omega[3];
    /* Of the last step: rotor speeds, specific force in the world, torque in the body. */
    double xi[GTMR_GUARD_ROTORS], thrust[3], torque[3];
    double target[3];
    double warm_s; /* time since the first measurement; negative before it */
    double quiet_s, zone_s;
    int braking;
    gtmr_guard_cause cause;
} gtmr_guard;

/* sizeof(gtmr_guard), for callers in other languages. */
size_t gtmr_guard_size(void);

/* Set the numbers of a guard, before its first reset or in flight. */
void gtmr_guard_configure(gtmr_guard *guard, const gtmr_guard_parameters *parameters);

/* Begin a flight. */
void gtmr_guard_reset(gtmr_guard *guard);

/*
 * Look at the vehicle and at the plan in play, and write what the rotors shall do [Hz/s] to u.
 *
 * dt_s: since the last step, above zero; not read in the first one. attitude: roll, pitch, yaw.
 * u_due: what the plan says for now [Hz/s], zeros past its end, NaN if it cannot be used.
 * overdue_s: how long the plan has been over, negative while it is not. age_s: since the state
 * that it was made for. u is u_due unless the guard is in charge.
 */
gtmr_guard_cause gtmr_guard_step(gtmr_guard *guard, double dt_s, const double *position,
                                 const double *attitude, const double *rotor_speeds,
                                 const double *u_due, double overdue_s, double age_s, double *u);

#endif
