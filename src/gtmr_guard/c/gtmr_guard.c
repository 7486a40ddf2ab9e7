// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* The same law stands in reference.py, step for step. */
#include "gtmr_guard.h"

#include <math.h>
#include <string.h>

#define ROTORS GTMR_GUARD_ROTORS
#define GRAVITY_M_S2 9.81

static const double MAX_DISTURBANCE_M_S2 = 4.0;
static const double MAX_ANGULAR_DISTURBANCE_RAD_S2 = 10.0;
static const double MAX_V_M_S = 30.0, MAX_OMEGA_RAD_S = 20.0;
/* Innovations that no vehicle can make between two steps. */
static const double JUMP_M = 0.5, JUMP_RAD = 1.0;
static const double UPSIDE_DOWN = 0.5;
static const double MAX_TURN_RAD_S = 3.0;
static const double MIN_LIFT = 0.3;
/* Change of a squared rotor speed that is none. */
static const double ROUNDING_HZ2 = 1e-6;

static double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double *a, const double *b, double *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static double between(double value, double low, double high)
{
    return fmin(fmax(value, low), high);
}

/* Shorten a vector of n entries to a norm. */
static void limit(double *a, int n, double bound)
{
    double norm = sqrt(n == 2 ? a[0] * a[0] + a[1] * a[1] : dot(a, a));
    int i;
    if (norm > bound)
        for (i = 0; i < n; i++)
            a[i] *= bound / norm;
}

/* A B, or A' B. */
static void product(double A[3][3], double B[3][3], int transposed, double C[3][3])
{
    int i, j;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            C[i][j] = transposed ? A[0][i] * B[0][j] + A[1][i] * B[1][j] + A[2][i] * B[2][j]
                                 : A[i][0] * B[0][j] + A[i][1] * B[1][j] + A[i][2] * B[2][j];
}

/* R' a. */
static void in_body(double R[3][3], const double *a, double *b)
{
    int i;
    for (i = 0; i < 3; i++)
        b[i] = R[0][i] * a[0] + R[1][i] * a[1] + R[2][i] * a[2];
}

/* Rz(yaw) Ry(pitch) Rx(roll), body to world. */
static void rotation(const double *eta, double R[3][3])
{
    double sr = sin(eta[0]), sp = sin(eta[1]), sy = sin(eta[2]);
    double cr = cos(eta[0]), cp = cos(eta[1]), cy = cos(eta[2]);
    R[0][0] = cy * cp, R[0][1] = cy * sp * sr - sy * cr, R[0][2] = cy * sp * cr + sy * sr;
    R[1][0] = sy * cp, R[1][1] = sy * sp * sr + cy * cr, R[1][2] = sy * sp * cr - cy * sr;
    R[2][0] = -sp, R[2][1] = cp * sr, R[2][2] = cp * cr;
}

/* R times the rotation by a vector, Rodrigues. */
static void rotate_by(double R[3][3], const double *a, double turned[3][3])
{
    double angle2 = dot(a, a), angle = sqrt(angle2);
    double s = angle > 1e-6 ? sin(angle) / angle : 1.0;
    double c = angle > 1e-6 ? (1.0 - cos(angle)) / angle2 : 0.5;
    double by[3][3];
    int i, j;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            by[i][j] = c * (a[i] * a[j] - (i == j ? angle2 : 0.0)) + (i == j ? 1.0 : 0.0);
    by[0][1] -= s * a[2], by[1][0] += s * a[2];
    by[0][2] += s * a[1], by[2][0] -= s * a[1];
    by[1][2] -= s * a[0], by[2][1] += s * a[0];
    product(R, by, 0, turned);
}

/* The vector of a rotation of less than half a turn. */
static void rotation_vector(double R[3][3], double *a)
{
    double sine, cosine = 0.5 * (R[0][0] + R[1][1] + R[2][2] - 1.0);
    int i;
    a[0] = 0.5 * (R[2][1] - R[1][2]);
    a[1] = 0.5 * (R[0][2] - R[2][0]);
    a[2] = 0.5 * (R[1][0] - R[0][1]);
    sine = sqrt(dot(a, a));
    if (sine > 1e-9)
        for (i = 0; i < 3; i++)
            a[i] *= atan2(sine, cosine) / sine;
}

/* Gains of a filter of position, speed and acceleration with three equal poles; at first they are
 * faster, so that it starts without a guess of the speed. */
static void gains(double rate, double dt_s, double warm_s, double *k)
{
    double theta = exp(-dt_s * fmax(rate, 3.0 / warm_s)), slow = exp(-dt_s * rate);
    k[0] = 1.0 - theta * theta * theta;
    k[1] = 1.5 * (1.0 - theta) * (1.0 - theta) * (1.0 + theta) / dt_s;
    k[2] = (1.0 - slow) * (1.0 - slow) * (1.0 - slow) / (dt_s * dt_s);
}

static int all_finite(const double *a, int n)
{
    int i;
    for (i = 0; i < n; i++)
        if (!isfinite(a[i]))
            return 0;
    return 1;
}

static void estimate_attitude(gtmr_guard *g, double dt_s, const double *eta, const double *torque)
{
    const double *J = g->is.inertia_kg_m2;
    double momentum[3], gyro[3], spin[3], turn[3], before[3][3], k[3], e[3];
    int i;
    for (i = 0; i < 3; i++)
        momentum[i] = J[i] * g->omega[i];
    cross(g->omega, momentum, gyro);
    for (i = 0; i < 3; i++) {
        spin[i] = (0.5 * (g->torque[i] + torque[i]) - gyro[i]) / J[i] + g->d_omega[i];
        turn[i] = dt_s * (g->omega[i] + 0.5 * dt_s * spin[i]);
        g->omega[i] += dt_s * spin[i];
    }
    rotate_by(g->R, turn, before);
    memcpy(g->R, before, sizeof before);
    memcpy(g->torque, torque, sizeof g->torque);
    if (eta != NULL) {
        double R[3][3], innovation[3][3];
        rotation(eta, R);
        product(before, R, 1, innovation);
        rotation_vector(innovation, e);
        memcpy(g->R, R, sizeof R);
        if (sqrt(dot(e, e)) <= JUMP_RAD) {
            gains(g->is.attitude_filter_rad_s, dt_s, g->warm_s, k);
            for (i = 0; i < 3; i++) {
                turn[i] = (k[0] - 1.0) * e[i];
                g->omega[i] += k[1] * e[i];
                g->d_omega[i] += k[2] * e[i];
            }
            rotate_by(R, turn, g->R);
            limit(g->d_omega, 3, MAX_ANGULAR_DISTURBANCE_RAD_S2);
        }
    }
    limit(g->omega, 3, MAX_OMEGA_RAD_S);
}

static void estimate_position(gtmr_guard *g, double dt_s, const double *p, const double *thrust)
{
    double k[3], e[3], before[3];
    int i;
    for (i = 0; i < 3; i++) {
        double a = 0.5 * (g->thrust[i] + thrust[i]) - (i == 2 ? GRAVITY_M_S2 : 0.0) + g->d[i];
        before[i] = g->p[i] + dt_s * (g->v[i] + 0.5 * dt_s * a);
        g->v[i] += dt_s * a;
        g->thrust[i] = thrust[i];
        g->p[i] = p != NULL ? p[i] : before[i];
        e[i] = g->p[i] - before[i];
    }
    if (p != NULL && sqrt(dot(e, e)) <= JUMP_M) {
        gains(g->is.position_filter_rad_s, dt_s, g->warm_s, k);
        for (i = 0; i < 3; i++) {
            g->p[i] = before[i] + k[0] * e[i];
            g->v[i] += k[1] * e[i];
            g->d[i] += k[2] * e[i];
        }
        limit(g->d, 3, MAX_DISTURBANCE_M_S2);
    }
    limit(g->v, 3, MAX_V_M_S);
}

/* Filter measurement and model: three poles each for position and for attitude. */
static void estimate(gtmr_guard *g, double dt_s, const double *p, const double *eta,
                     const double *xi)
{
    int seen = all_finite(p, 3) && all_finite(eta, 3) && all_finite(xi, ROTORS);
    int first = g->warm_s < 0.0, i, j;
    double wrench[6] = {0.0}, thrust[3];
    if (first && !seen)
        return;
    if (seen)
        memcpy(g->xi, xi, sizeof g->xi);
    for (i = 0; i < 6; i++)
        for (j = 0; j < ROTORS; j++)
            wrench[i] += g->is.allocation[i][j] * (g->xi[j] * g->xi[j]);
    if (first) {
        g->warm_s = 0.0;
        memcpy(g->p, p, sizeof g->p);
        rotation(eta, g->R);
        memcpy(g->torque, wrench + 3, sizeof g->torque);
    } else {
        g->warm_s += dt_s;
        estimate_attitude(g, dt_s, seen ? eta : NULL, wrench + 3);
    }
    for (i = 0; i < 3; i++)
        thrust[i] = dot(g->R[i], wrench) / g->is.mass_kg;
    if (first)
        memcpy(g->thrust, thrust, sizeof g->thrust);
    else
        estimate_position(g, dt_s, seen ? p : NULL, thrust);
}

/* Distance from the tower's axis, and the unit vector away from it. */
static double radial(const gtmr_guard *g, double *outward)
{
    double rho = sqrt(g->p[0] * g->p[0] + g->p[1] * g->p[1]);
    outward[0] = rho < 1e-6 ? 1.0 : g->p[0] / rho;
    outward[1] = rho < 1e-6 ? 0.0 : g->p[1] / rho;
    outward[2] = 0.0;
    return rho;
}

/* Whether a command is one that rotors can be told; no number is not. */
static int is_usable(const gtmr_guard_parameters *k, const double *u_due)
{
    int i;
    for (i = 0; i < ROTORS; i++)
        if (!(fabs(u_due[i]) <= k->max_command_hz_s))
            return 0;
    return 1;
}

static void decide(gtmr_guard *g, double dt_s, const double *u_due, double overdue_s, double age_s)
{
    const gtmr_guard_parameters *k = &g->is;
    double outward[3], clearance, v_r, v_then, stop, speed, rate;
    gtmr_guard_cause cause = GTMR_GUARD_NONE;
    if (g->warm_s < 0.0)
        return;
    clearance = radial(g, outward) - k->tower_radius_m;
    v_r = dot(outward, g->v);
    speed = sqrt(dot(g->v, g->v)), rate = sqrt(dot(g->omega, g->omega));
    g->zone_s = clearance < k->zone_m && v_r < k->stopped_m_s ? g->zone_s + dt_s : 0.0;
    /* Where it would come to rest if it began to brake now, and its push inward went on until that
     * takes effect. */
    v_then = v_r + k->reaction_s * fmin(dot(outward, g->thrust) + dot(outward, g->d), 0.0);
    stop = clearance + 0.5 * k->reaction_s * (v_r + v_then);
    stop -= v_then * v_then / (2.0 * k->brake_m_s2);

    if (!is_usable(k, u_due))
        cause = GTMR_GUARD_UNUSABLE;
    else if (overdue_s > k->patience_s || age_s > k->max_plan_age_s)
        cause = GTMR_GUARD_ENDED;
    else if (g->R[2][2] < k->min_tilt_cosine)
        cause = GTMR_GUARD_TILT;
    else if (speed > k->max_speed_m_s || rate > k->max_rate_rad_s)
        cause = GTMR_GUARD_SPEED;
    else if (g->zone_s > k->zone_time_s || (v_r < 0.0 && stop < k->zone_m))
        cause = GTMR_GUARD_ZONE;

    if (cause != GTMR_GUARD_NONE) {
        if (g->cause == GTMR_GUARD_NONE)
            g->braking = 1;
        g->cause = cause;
        g->quiet_s = 0.0;
    } else if (g->cause != GTMR_GUARD_NONE) {
        int well = overdue_s < 0.0 && age_s <= k->fresh_s &&
                   g->R[2][2] > 0.5 * (1.0 + k->min_tilt_cosine) &&
                   speed < 0.5 * k->max_speed_m_s && rate < 0.5 * k->max_rate_rad_s &&
                   clearance > k->min_clearance_m;
        g->quiet_s = well ? g->quiet_s + dt_s : 0.0;
        if (g->quiet_s >= k->handback_s)
            g->cause = GTMR_GUARD_NONE;
    }
}

/* Add as much of what is asked for more, on axes from to end of the inverse, as the rotors can. */
static void allocate(const gtmr_guard_parameters *k, const double *wrench, int from, int end,
                     double *squared)
{
    double low = k->min_rotor_speed_hz * k->min_rotor_speed_hz;
    double high = k->max_rotor_speed_hz * k->max_rotor_speed_hz;
    double more[ROTORS], share = 1.0;
    int i, j;
    for (i = 0; i < ROTORS; i++) {
        more[i] = 0.0;
        for (j = from; j < end; j++)
            more[i] += k->inverse[i][j] * wrench[j];
        if (more[i] > ROUNDING_HZ2 && squared[i] + share * more[i] > high)
            share = fmax(0.0, (high - squared[i]) / more[i]);
        else if (more[i] < -ROUNDING_HZ2 && squared[i] + share * more[i] < low)
            share = fmax(0.0, (low - squared[i]) / more[i]);
    }
    for (i = 0; i < ROTORS; i++)
        squared[i] += share * more[i];
}

/* The force that brakes, moves away from the tower and hovers, world frame [N]. */
static void wanted_force(gtmr_guard *g, double *force)
{
    const gtmr_guard_parameters *k = &g->is;
    double outward[3], along[3], v_wanted[3], a[3];
    double rho = radial(g, outward), v_r = dot(outward, g->v);
    int i;
    if (g->braking) {
        double there = fmax(rho, k->tower_radius_m + k->retreat_clearance_m);
        for (i = 0; i < 3; i++) {
            along[i] = g->v[i] - v_r * outward[i];
            g->target[i] = i == 2 ? g->p[2] : there * outward[i];
        }
        g->braking = sqrt(dot(along, along)) > k->stopped_m_s;
    }
    for (i = 0; i < 3; i++)
        v_wanted[i] = k->position_gain * (g->target[i] - g->p[i]);
    limit(v_wanted, 3, k->retreat_speed_m_s);
    for (i = 0; i < 3; i++)
        a[i] = k->velocity_gain * (v_wanted[i] - g->v[i]);
    limit(a, 2, k->max_acceleration_m_s2);
    a[2] = between(a[2], -k->max_acceleration_m_s2, GRAVITY_M_S2);
    for (i = 0; i < 3; i++)
        force[i] = k->mass_kg * (a[i] + (i == 2 ? GRAVITY_M_S2 : 0.0) - g->d[i]);
    force[2] = fmax(force[2], MIN_LIFT * k->mass_kg * GRAVITY_M_S2);
}

static void retreat(gtmr_guard *g, double *u)
{
    const gtmr_guard_parameters *k = &g->is;
    double force[3], outward[3], wrench[6], aim[3], axis[3] = {1.0, 0.0, 0.0};
    double momentum[3], gyro[3], squared[ROTORS], upright, sine, turn, thrust;
    int i;
    wanted_force(g, force);
    radial(g, outward);
    in_body(g->R, force, wrench);
    upright = wrench[2] / sqrt(dot(wrench, wrench));

    /* Turn the thrust axis, body e3, into the wanted force; heading is left free. Upside
     * down, turn by way of outward, so that thrust does not sweep across the tower. */
    in_body(g->R, upright < -UPSIDE_DOWN ? outward : force, aim);
    sine = sqrt(aim[0] * aim[0] + aim[1] * aim[1]);
    if (sine > 1e-9) {
        axis[0] = -aim[1] / sine;
        axis[1] = aim[0] / sine;
    }
    turn = fmin(k->attitude_gain * atan2(sine, aim[2]), MAX_TURN_RAD_S);
    for (i = 0; i < 3; i++)
        momentum[i] = k->inertia_kg_m2[i] * g->omega[i];
    cross(g->omega, momentum, gyro);
    for (i = 0; i < 3; i++) {
        double spin = k->rate_gain * (turn * axis[i] - g->omega[i]) - g->d_omega[i];
        wrench[3 + i] = k->inertia_kg_m2[i] * spin + gyro[i];
    }

    /* Roll and pitch go before sideways force, and all before yaw, whose torque is dear. */
    thrust = between(wrench[2], k->min_thrust_n, k->max_thrust_n);
    for (i = 0; i < ROTORS; i++)
        squared[i] = k->inverse[i][2] * thrust;
    allocate(k, wrench, 3, 5, squared);
    if (upright > UPSIDE_DOWN)
        allocate(k, wrench, 0, 2, squared);
    allocate(k, wrench, 5, 6, squared);
    for (i = 0; i < ROTORS; i++) {
        double low = k->min_rotor_speed_hz, high = k->max_rotor_speed_hz;
        double xi = sqrt(between(squared[i], low * low, high * high));
        double most = k->max_rotor_acceleration_hz_s;
        u[i] = between(k->rotor_gain * (xi - g->xi[i]), -most, most);
    }
}

size_t gtmr_guard_size(void)
{
    return sizeof(gtmr_guard);
}

void gtmr_guard_configure(gtmr_guard *guard, const gtmr_guard_parameters *parameters)
{
    guard->is = *parameters;
}

void gtmr_guard_reset(gtmr_guard *guard)
{
    gtmr_guard_parameters is = guard->is;
    memset(guard, 0, sizeof *guard);
    guard->is = is;
    guard->warm_s = -1.0;
}

gtmr_guard_cause gtmr_guard_step(gtmr_guard *guard, double dt_s, const double *position,
                                 const double *attitude, const double *rotor_speeds,
                                 const double *u_due, double overdue_s, double age_s, double *u)
{
    estimate(guard, dt_s, position, attitude, rotor_speeds);
    decide(guard, dt_s, u_due, overdue_s, age_s);
    if (guard->cause != GTMR_GUARD_NONE)
        retreat(guard, u);
    else if (overdue_s < 0.0 && is_usable(&guard->is, u_due))
        memcpy(u, u_due, ROTORS * sizeof *u);
    else
        memset(u, 0, ROTORS * sizeof *u);
    return guard->cause;
}
