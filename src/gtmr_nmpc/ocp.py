# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The nominal optimal control problem, eq. (5) and (6): discretisation, outputs, reference."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model.dynamics import (
    ATTITUDE,
    POSITION,
    RATE,
    VELOCITY,
    discrete_step,
    state_derivative,
    symbols,
)
from gtmr_model.uncertainty import N_ZETA
from gtmr_nmpc.config import ControllerConfig

Array = NDArray[np.float64]

OUTPUTS = (
    *("position",) * 3,
    *("velocity",) * 3,
    *("acceleration",) * 3,
    *("roll_pitch",) * 2,
    "yaw",
    *("rate",) * 3,
)
"""What the entries of h(x) are, eq. (6); attitude and rate are not in the paper's cost."""
N_H = len(OUTPUTS)
"""Length of h(x)."""


def discrete_dynamics(config: ControllerConfig) -> ca.Function:
    """F of eq. (5b), (x, u, zeta) -> x_next: one RK4 step over T_s without gust."""
    x, u, zeta, _ = symbols(config.vehicle)
    x_next = discrete_step(x, u, zeta, ca.DM.zeros(3), config.vehicle, config.sampling_time_s)
    return ca.Function("F", [x, u, zeta], [x_next], ["x", "u", "zeta"], ["x_next"])


def disturbed_dynamics(config: ControllerConfig) -> ca.Function:
    """F with disturbances: (x, u, zeta, force, torque) -> x_next.

    The force is in the world frame [N], the torque in the body frame [N m], both held over T_s.
    """
    x, u, zeta, force = symbols(config.vehicle)
    torque = ca.SX.sym("torque", 3)
    x_next = discrete_step(x, u, zeta, force, config.vehicle, config.sampling_time_s, torque)
    names = ["x", "u", "zeta", "force", "torque"]
    return ca.Function("F", [x, u, zeta, force, torque], [x_next], names, ["x_next"])


def output_map(config: ControllerConfig) -> ca.Function:
    """Output map h of eq. (6): position, velocity, acceleration, attitude and body rates.

    x -> h, shape (15,); acceleration along eq. (3) at zeta = 0 without gust.
    """
    x, u, _, _ = symbols(config.vehicle)
    nominal = ca.DM.zeros(N_ZETA)
    acceleration = state_derivative(x, u, nominal, ca.DM.zeros(3), config.vehicle)[VELOCITY]
    h = ca.vertcat(x[POSITION], x[VELOCITY], acceleration, x[ATTITUDE], x[RATE])
    return ca.Function("h", [x], [h], ["x"], ["h"])


def stage_weights(config: ControllerConfig) -> Array:
    """Diagonal of Q, eq. (6), in the order of `output_map`, shape (15,)."""
    w = config.weights
    return np.array(
        [*w.position, *w.velocity, *w.acceleration, *(w.roll_pitch,) * 2, w.yaw, *(w.rate,) * 3]
    )


@dataclass(frozen=True)
class HorizonReference:
    """r_i of eq. (6) for a whole horizon."""

    stages: Array
    """References of h at stages 0..N-1, shape (N, 15)."""
    terminal: Array
    """Reference of h_f, the position at stage N [m], shape (3,)."""


def horizon_reference(config: ControllerConfig, t: float) -> HorizonReference:
    """Sample the helix over the horizon that starts at t [s]."""
    times = t + config.sampling_time_s * np.arange(config.horizon + 1)
    helix = config.helix.at(times, config.tower)
    zeros = np.zeros((len(times), 2))
    stages = np.hstack(
        [
            helix.position,
            helix.velocity,
            helix.acceleration,
            zeros,
            helix.yaw[:, None],
            zeros,
            helix.yaw_rate[:, None],
        ]
    )
    return HorizonReference(stages=stages[:-1], terminal=helix.position[-1])
