# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What tubes need of the vehicle: its linear model, and feedback about a plan."""

import math
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model import Vehicle
from gtmr_model.dynamics import (
    POSITION,
    ROTORS,
    VELOCITY,
    YAW,
    one_at_a_time,
)
from gtmr_nmpc import ControllerConfig, ocp
from gtmr_study.rivals.robust_mpc.linearised import jacobians

Array = NDArray[np.float64]


FACING_RAD = math.pi
"""Yaw at which hover is linearised, facing the tower from the x axis [rad]."""
DIGITS = 10
"""Kept of the gains: the rest depends on how many threads solve an equation."""


@lru_cache(maxsize=8)
@one_at_a_time
def _outputs(vehicle: Vehicle) -> ca.Function:
    h, x = ocp.output_map(ControllerConfig(vehicle=vehicle)), ca.SX.sym("x", vehicle.n_x)
    return ca.Function("dh", [x], [ca.densify(ca.jacobian(h(x), x))])


def hover(config: ControllerConfig, yaw_rad: float = FACING_RAD) -> Array:
    """State of level hover at the origin at a yaw [rad], shape (12 + N_p,)."""
    x = np.zeros(config.vehicle.n_x)
    x[YAW] = yaw_rad
    x[ROTORS] = config.vehicle.hover_rotor_speeds_hz
    return x


def about_hover(config: ControllerConfig, yaw_rad: float = FACING_RAD) -> tuple[Array, ...]:
    """Evaluate A, B, E (of zeta) and G (of gusts) of a step about level hover at a yaw [rad]."""
    of = jacobians(config.vehicle, config.sampling_time_s)
    at = hover(config, yaw_rad), np.zeros(config.vehicle.n_rotors)
    return tuple(np.asarray(block) for block in of(*at))


class Ancillary:
    """Feedback u = v + K (x - z) about a plan z, v: the LQR of the QP's own weights at hover."""

    def __init__(self, config: ControllerConfig) -> None:
        self._gain = _gain(config)

    def gain(self, yaw_rad: float) -> Array:
        """K [Hz/s per unit of state] at a yaw of the plan [rad], shape (N_p, 12 + N_p).

        Hover turned about z is hover: position and velocity errors are turned back.
        """
        angle = yaw_rad - FACING_RAD
        cos, sin = math.cos(angle), math.sin(angle)
        back = np.array([[cos, sin], [-sin, cos]])
        gain = self._gain.copy()
        for first in (POSITION.start, VELOCITY.start):
            axes = slice(first, first + 2)
            gain[:, axes] = self._gain[:, axes] @ back
        return gain


@lru_cache(maxsize=64)
def _gain(config: ControllerConfig) -> Array:
    # Imported here, as it takes longer than all else of a flight's start.
    from scipy.linalg import solve_discrete_are

    a, b, _, _ = about_hover(config)
    dh = np.asarray(_outputs(config.vehicle)(hover(config)))
    q = dh.T @ (ocp.stage_weights(config)[:, None] * dh)
    r = config.weights.rotor_acceleration * np.eye(config.vehicle.n_rotors)
    p = solve_discrete_are(a, b, q, r)
    exact = -np.linalg.solve(b.T @ p @ b + r, b.T @ p @ a)
    unit = 10.0 ** (np.ceil(np.log10(np.abs(exact).max())) - DIGITS)
    return np.asarray(np.round(exact / unit) * unit)
