# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Cascade of PIDs with geometric attitude control, for rotors that push into any direction.

Position and velocity errors ask for an acceleration, attitude and rate errors for an angular
acceleration (attitude on SO(3): Lee, Leok, McClamroch, CDC 2010); the vehicle's own allocation
matrix turns force and torque into rotor speeds, and a first-order loop into rotor accelerations.
It assumes nothing but mass, inertia and allocation, and that what is wrong with them changes
slowly: the integrals must find it. They are bounded, and each waits while rotors at their limits
cannot give what it asks for. Bandwidths, damping and integral time are tuned for each world;
nearly all the time of a step is Python.
It breaks under gusts, which an integral follows late, and near the wall, since it knows
no constraint. Its friends say that nearly everything that flies today flies on it, on the state of
a good filter; so it has that of the suite's Kalman filter, of whose estimated disturbance it makes
no use, the reference's velocity, acceleration and yaw rate as feed-forward, and the same
prediction over the delay and lead over the motors as everybody else.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from gtmr_model.dynamics import ATTITUDE, POSITION, RATE, ROTORS, VELOCITY
from gtmr_nmpc import ControllerConfig
from gtmr_study.rivals.feedback.present import OneStepPlan, Present
from gtmr_study.rivals.feedback.wrench import Wrench, attitude_error, cross, rotation_of
from gtmr_study.rivals.tuning import RivalParameters, Tuned

Array = NDArray[np.float64]

MAX_INTEGRAL = 4.0
"""Bound on what each integral adds [m/s^2, rad/s^2]: more than the uncertainty set can explain."""


class PidParameters(RivalParameters):
    """What the cascade is tuned by."""

    position_rad_s: float = Field(3.0, ge=0.8, le=12.0)
    """Natural frequency of the position loop [rad/s]."""
    damping: float = Field(1.0, ge=0.5, le=3.0)
    """Damping ratio of the position loop [-]."""
    integral_s: float = Field(1.0, ge=0.15, le=10.0)
    """Integral time of both loops [s]."""
    attitude_rad_s: float = Field(8.0, ge=2.0, le=20.0)
    """Natural frequency of the attitude loop, which is critically damped [rad/s]."""


class Pid:
    """The cascade, with the integrals of one flight."""

    def __init__(self, config: ControllerConfig, parameters: PidParameters) -> None:
        self.config, self._is = config, parameters
        self._present, self._wrench = Present(config), Wrench(config.vehicle)
        self._integrals = np.zeros(6)
        self._stamp_s: float | None = None

    def step(self, t: float, x: ArrayLike, now: float | None = None) -> OneStepPlan:
        """Decide from the state x measured at t [s], for rotors that answer from ``now`` [s]."""
        now = t if now is None else now
        state, _ = self._present.estimate(t, np.array(x, dtype=float), now)
        config, vehicle, by = self.config, self.config.vehicle, self._is
        dt_s = 0.0 if self._stamp_s is None else t - self._stamp_s
        at = config.helix.at(now, config.tower)
        self._stamp_s = t
        v, omega = state[VELOCITY], state[RATE]
        accelerated, turned = np.split(self._integrals, 2)

        far = at.position[0] - state[POSITION]
        slow = at.velocity[0] - v
        kp, kv = by.position_rad_s**2, 2.0 * by.damping * by.position_rad_s
        wanted = at.acceleration[0] + kp * far + kv * slow + accelerated
        force = vehicle.mass_kg * wanted + vehicle.drag_n_s_per_m * v + self._wrench.hover_force()

        actual = rotation_of(state[ATTITUDE])
        level = self._wrench.attitude_for(force, float(at.yaw[0]))
        off = -attitude_error(actual, level)
        spin = actual.T @ [0.0, 0.0, float(at.yaw_rate[0])] - omega
        k_r, k_w = by.attitude_rad_s**2, 2.0 * by.attitude_rad_s
        inertia = np.array(vehicle.inertia_kg_m2)
        torque = inertia * (k_r * off + k_w * spin + turned) + cross(omega, inertia * omega)

        wrench = np.concatenate((actual.T @ force, torque))
        u = self._wrench.rotor_accelerations(wrench, state[ROTORS])
        growth = np.concatenate((kp * far, k_r * off)) * dt_s / by.integral_s
        growth[:3] *= not self._wrench.force_is_limited
        growth[3:] *= not self._wrench.torque_is_limited
        self._integrals = np.clip(self._integrals + growth, -MAX_INTEGRAL, MAX_INTEGRAL)
        return self._present.send(t, state, now, u)


PID = Tuned("pid", PidParameters, Pid)
"""Cascade of PIDs."""
