# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The guard as plain C99 beside the controller: sources, numbers, a flight to check it against."""

from __future__ import annotations

from typing import Any

import numpy as np

from gtmr_guard import CAUSES, Guard
from gtmr_guard.compiled import c_sources
from gtmr_guard.config import GuardConfig, parameters
from gtmr_model.dynamics import ATTITUDE, POSITION, ROTORS
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import Plant

FLIGHT_S = 4.0
"""Length of the recorded flight [s]."""
SILENCE_S = (1.0, 2.5)
"""From when to when in it no plans come [s]."""
TICK_S = 0.005
"""Between two steps of the guard in it [s]."""


def guard_files(config: ControllerConfig) -> dict[str, str]:
    """All that the export has of the guard, by file name."""
    return c_sources(config.vehicle.n_rotors) | {
        "guard_parameters.h": _parameters_header(config),
        "guard.csv": _flight(config),
    }


def _told(config: ControllerConfig) -> GuardConfig:
    """Give the guard's settings for the delay and the lag that the controller is told of."""
    return GuardConfig.told(config.sampling_time_s, config.delay_s, config.motor_lag_s)


def _parameters_header(config: ControllerConfig) -> str:
    values = parameters(config.vehicle, config.tower, _told(config))
    fields = ",\n".join(
        f"    /* {name} */ {_literal(value)}" for name, value in values._asdict().items()
    )
    return f"""\
/* Generated: the numbers of one vehicle and tower; gtmr_guard.h says what they are. */
#ifndef GTMR_GUARD_PARAMETERS_H
#define GTMR_GUARD_PARAMETERS_H

#include "gtmr_guard.h"

static const gtmr_guard_parameters gtmr_guard_numbers = {{
{fields}
}};

#endif
"""


def _literal(value: Any) -> str:
    if np.ndim(value):
        return "{" + ", ".join(_literal(entry) for entry in np.asarray(value)) + "}"
    return repr(float(value))


def _flight(config: ControllerConfig) -> str:
    """Record a flight under wind towards the tower, whose controller is silent for a while.

    Rows of dt, p, eta, xi, u_due, overdue, age, cause and u.
    """
    vehicle, period_s = config.vehicle, config.sampling_time_s
    zeta = (*(0.0,) * 6, *(0.7 * bound for bound in config.uncertainty.wind_bias_n))
    plant = Plant(vehicle, zeta, config.helix.initial_state(config.tower, vehicle), TICK_S)
    guard, controller = Guard(vehicle, config.tower, _told(config)), Controller(config)
    plan, stamp_s = np.zeros((0, vehicle.n_rotors)), 0.0
    rows = []
    for k in range(round(FLIGHT_S / TICK_S)):
        t = k * TICK_S
        due_s = stamp_s + period_s if len(plan) else 0.0
        if t >= due_s - 1e-9 and not SILENCE_S[0] <= t < SILENCE_S[1]:
            plan, stamp_s = controller.step(t, plant.x).u_plan, t
        age_s = t - stamp_s
        overdue_s = age_s - len(plan) * period_s
        # A little later than on the edge of two stages, where rounding would decide.
        stage = int((age_s + 1e-9) / period_s)
        u_due = plan[stage] if overdue_s < -1e-9 else np.zeros(vehicle.n_rotors)
        x = plant.x
        u = guard.step(TICK_S, x, u_due, overdue_s, age_s)
        numbers = (TICK_S, *x[POSITION], *x[ATTITUDE], *x[ROTORS], *u_due, overdue_s, age_s)
        rows.append(",".join(repr(float(v)) for v in (*numbers, CAUSES.index(guard.cause), *u)))
        plant.advance(u, np.zeros(3), 1)
    return "\n".join(rows) + "\n"
