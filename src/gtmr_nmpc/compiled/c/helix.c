// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

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
