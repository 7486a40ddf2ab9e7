# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""LQR about hover in the frame that faces the tower, with integral action by an observer.

It assumes a vehicle near hover, whose linearisation holds wherever it is around the tower, and
knows no constraint: clearance comes from tracking alone. Integral action is that of a disturbance
observer (the suite's own Kalman filter, with the noise of the world): the force and torque that it
finds are cancelled by the rotor speeds of the equilibrium, so that nothing winds up. Its weights
and how fast disturbances are believed to wander are tuned for each world. A step costs a few
hundred multiplications; nearly all its time is Python. It breaks where the distance to the tower
is all that counts: it deviates inward as often as outward, so that d_ref must leave room for its
whole error. Its friends say that a good LQG tracker needs no constraint; so it has the same
filter, the same prediction over the delay and the same lead over the motors as the NMPC.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from gtmr_model import N_ZETA, Vehicle, dynamics
from gtmr_model.dynamics import ATTITUDE, POSITION, RATE, ROTORS, VELOCITY, YAW
from gtmr_model.vehicle import GRAVITY_M_S2
from gtmr_nmpc import ControllerConfig
from gtmr_nmpc.observer import BIAS, GUST, TORQUE
from gtmr_study.rivals.feedback.present import OneStepPlan, Present
from gtmr_study.rivals.tuning import RivalParameters, Tuned

Array = NDArray[np.float64]

INPUT_WEIGHT = 1e-6
"""Weight of rotor accelerations [(Hz/s)^-2]: the unit of all others."""
TILT_SHARE = 0.01
"""By how much tilting is dearer than changing rotor speeds, where both can make a force [rad]."""
DIGITS = 10
"""Kept of the gains: the rest depends on how many threads solve an equation."""


class LqrParameters(RivalParameters):
    """What the LQR is tuned by."""

    position: float = Field(500.0, ge=10.0, le=2e4)
    """Weight of the position [m^-2]."""
    velocity: float = Field(10.0, ge=0.1, le=1e3)
    """Weight of the velocity [(m/s)^-2]."""
    attitude: float = Field(50.0, ge=1.0, le=5e3)
    """Weight of roll, pitch and yaw [rad^-2]."""
    rate: float = Field(5.0, ge=0.05, le=500.0)
    """Weight of the body rates [(rad/s)^-2]."""
    force_n_per_sqrt_s: float = Field(1.0, ge=0.05, le=20.0)
    """How fast the force beyond the model is believed to wander [N/sqrt(s)]."""
    torque_nm_per_sqrt_s: float = Field(0.1, ge=0.005, le=2.0)
    """How fast the torque beyond the model is believed to wander [N m/sqrt(s)]."""


class Lqr:
    """State feedback to the equilibrium that follows the path under the estimated disturbance."""

    def __init__(self, config: ControllerConfig, parameters: LqrParameters) -> None:
        disturbance = config.offset_free.disturbance.model_copy(
            update={
                "bias_n_per_sqrt_s": parameters.force_n_per_sqrt_s,
                "torque_nm_per_sqrt_s": parameters.torque_nm_per_sqrt_s,
            }
        )
        observes = config.offset_free.model_copy(update={"disturbance": disturbance})
        self.config = config.model_copy(update={"offset_free": observes})
        self._present = Present(self.config)
        self._gain = gain(config.vehicle, config.sampling_time_s, parameters)
        self._trim = trim(config.vehicle)

    def step(self, t: float, x: ArrayLike, now: float | None = None) -> OneStepPlan:
        """Decide from the state x measured at t [s], for rotors that answer from ``now`` [s]."""
        now = t if now is None else now
        state, theta = self._present.estimate(t, np.array(x, dtype=float), now)
        config, vehicle = self.config, self.config.vehicle
        at = config.helix.at(now, config.tower)
        yaw, yaw_rate = float(at.yaw[0]), float(at.yaw_rate[0])
        c, s = math.cos(yaw), math.sin(yaw)
        to_heading = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

        along = at.acceleration[0] + [0.0, 0.0, GRAVITY_M_S2]
        force = vehicle.mass_kg * along + vehicle.drag_n_s_per_m * at.velocity[0]
        force = to_heading @ (force - theta[BIAS] - theta[GUST])
        tilt, squared = np.split(self._trim @ np.concatenate((force, -theta[TORQUE])), [2])
        low, high = vehicle.min_rotor_speed_hz, vehicle.max_rotor_speed_hz

        error = np.zeros(vehicle.n_x)
        error[POSITION] = to_heading @ (state[POSITION] - at.position[0])
        error[ATTITUDE] = state[ATTITUDE] - [*tilt, yaw]
        error[YAW] -= math.tau * round(error[YAW] / math.tau)
        error[VELOCITY] = to_heading @ (state[VELOCITY] - at.velocity[0])
        error[RATE] = state[RATE] - [0.0, 0.0, yaw_rate]
        error[ROTORS] = state[ROTORS] - np.sqrt(np.clip(squared, low**2, high**2))
        return self._present.send(t, state, now, -self._gain @ error)


def trim(vehicle: Vehicle) -> Array:
    """Map a wrench near hover, heading frame [N, N m], to roll, pitch [rad] and xi^2 [Hz^2].

    Shape (2 + N_p, 6). Of all that give it the one that tilts least; the squared speeds of a level
    vehicle are exact.
    """
    weight_n = vehicle.mass_kg * GRAVITY_M_S2
    # A tilt turns the thrust: forward by pitch, to the right by roll.
    by_tilt = np.zeros((6, 2))
    by_tilt[1, 0], by_tilt[0, 1] = -weight_n, weight_n
    scale = np.concatenate(([TILT_SHARE] * 2, vehicle.hover_rotor_speeds_hz**2))
    return np.asarray(
        scale[:, None] * np.linalg.pinv(np.hstack((by_tilt, vehicle.allocation)) * scale)
    )


@lru_cache(maxsize=64)
def gain(vehicle: Vehicle, sampling_time_s: float, parameters: LqrParameters) -> Array:
    """Gain from a state's deviation to rotor accelerations [Hz/s], shape (N_p, 12 + N_p).

    That of the infinite horizon with the input held over a sampling time [s].
    """
    # Imported here, as it takes longer than all else of a flight's start.
    from scipy.linalg import expm, solve_discrete_are

    n_x, n_u = vehicle.n_x, vehicle.n_rotors
    hover = np.concatenate((np.zeros(12), vehicle.hover_rotor_speeds_hz, np.zeros(n_u)))

    def derivative(z: Array) -> Array:
        return dynamics(z[:n_x], z[n_x:], np.zeros(N_ZETA), np.zeros(3), vehicle)

    moves = 1e-5 * np.eye(n_x + n_u)
    jacobian = np.zeros((n_x + n_u, n_x + n_u))
    jacobian[:n_x] = np.array([derivative(hover + h) - derivative(hover - h) for h in moves]).T
    discrete = expm(jacobian / 2e-5 * sampling_time_s)
    a, b = discrete[:n_x, :n_x], discrete[:n_x, n_x:]
    weights = [
        *[parameters.position] * 3,
        *[parameters.attitude] * 3,
        *[parameters.velocity] * 3,
        *[parameters.rate] * 3,
        # Speeds alone are no aim, but those of more rotors than a wrench needs must not drift.
        *[INPUT_WEIGHT] * n_u,
    ]
    r = INPUT_WEIGHT * np.eye(n_u)
    p = solve_discrete_are(a, b, np.diag(weights), r)
    exact = np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)
    unit = 10.0 ** (np.ceil(np.log10(np.abs(exact).max())) - DIGITS)
    rounded = np.asarray(np.round(exact / unit) * unit)
    # All flights of a process read the same array.
    rounded.setflags(write=False)
    return rounded


LQR = Tuned("lqr", LqrParameters, Lqr)
"""LQR about hover."""
