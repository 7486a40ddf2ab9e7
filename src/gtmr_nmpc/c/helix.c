/* Copyright 2026 the gtmr authors
 * SPDX-License-Identifier: Apache-2.0 */
/* The inspection reference: a helix round the tower, eq. (2). */
#include "workspace.h"

void helix_reference(const gtmr_parameters *parameters, double t, double *reference)
{
    const double pi = 3.14159265358979323846;
    const double radius = parameters->helix_radius_m;
    const double speed = parameters->helix_speed_m_s;
    const double rate = speed / radius;
    const double angle = parameters->helix_start_angle_rad + rate * t;
    const double c = cos(angle), s = sin(angle);
    const double outputs[N_H] = {
        radius * c,
        radius * s,
        parameters->helix_start_height_m + parameters->helix_climb_m_s * t,
        -speed * s,
        speed * c,
        parameters->helix_climb_m_s,
        -speed * rate * c,
        -speed * rate * s,
        0.0,
        0.0,
        0.0,
        angle + pi,
        0.0,
        0.0,
        rate,
    };
    for (int i = 0; i < N_H; ++i) {
        reference[i] = outputs[i];
    }
}
