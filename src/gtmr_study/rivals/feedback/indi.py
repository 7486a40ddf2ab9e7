# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Incremental nonlinear dynamic inversion on filtered accelerations.

The wrench of the moment is changed by what the accelerations lack: f = f_0 + m (a_wanted - a_0)
and tau = tau_0 + J (alpha_wanted - alpha_0) (Smeur, Chu, de Croon, JGCD 2016; Tal and Karaman,
T-CST 2021). a_0 and alpha_0 are differences of the measured velocity and rates, f_0 and tau_0 come
from the measured rotor speeds over the same time; one second-order filter for all keeps them
synchronous. It assumes that what disturbs now will go on for a moment, and of the model only mass,
inertia and allocation: mismatch, wind and wall need no name. Its bandwidths and its filter are
tuned for each world; nearly all the time of a step is Python. It breaks where accelerations
cannot be measured: differences of a velocity with 5 cm/s of noise at 40 Hz are 2.8 m/s^2 of noise,
so that the filter must be slow and gusts pass; and at the start of a flight, when all that
disturbs is new, it comes closest to the tower. It knows no constraint. Its friends say that it
needs a good accelerometer at 500 Hz and more; there is none in these worlds, for nobody, so it
gets the filter that suits them best, and its outer loop the state of the suite's Kalman filter,
brought up to now, of whose estimated disturbance it makes no use.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from gtmr_model.dynamics import ATTITUDE, POSITION, RATE, ROTORS, VELOCITY
from gtmr_nmpc import ControllerConfig
from gtmr_study.rivals.feedback.present import OneStepPlan, Present
from gtmr_study.rivals.feedback.wrench import Wrench, attitude_error, rotation_of
from gtmr_study.rivals.tuning import RivalParameters, Tuned

Array = NDArray[np.float64]


class IndiParameters(RivalParameters):
    """What the incremental inversion is tuned by."""

    position_rad_s: float = Field(3.0, ge=0.8, le=12.0)
    """Natural frequency of the position loop [rad/s]."""
    damping: float = Field(1.0, ge=0.5, le=3.0)
    """Damping ratio of the position loop [-]."""
    attitude_rad_s: float = Field(8.0, ge=2.0, le=20.0)
    """Natural frequency of the attitude loop, which is critically damped [rad/s]."""
    filter_rad_s: float = Field(10.0, ge=0.5, le=60.0)
    """Cut-off of the Butterworth filter of accelerations and wrench [rad/s]."""


class Butterworth:
    """Second-order low-pass filter of a vector, by the bilinear transform.

    It starts as if the first input had always been.
    """

    def __init__(self, cutoff_rad_s: float, period_s: float) -> None:
        k = math.tan(0.5 * cutoff_rad_s * period_s)
        scale = 1.0 + math.sqrt(2.0) * k + k * k
        self._b = k * k / scale
        self._a1 = 2.0 * (k * k - 1.0) / scale
        self._a2 = (1.0 - math.sqrt(2.0) * k + k * k) / scale
        self._last: tuple[Array, Array, Array, Array] | None = None

    def __call__(self, value: Array) -> Array:
        """Take in the next sample, and give the filtered one."""
        if self._last is None:
            self._last = (value,) * 4
        in1, in2, out1, out2 = self._last
        out = self._b * (value + 2.0 * in1 + in2) - self._a1 * out1 - self._a2 * out2
        self._last = (value, in1, out, out1)
        return out


class Indi:
    """Incremental inversion, with the filters of one flight."""

    def __init__(self, config: ControllerConfig, parameters: IndiParameters) -> None:
        self.config, self._is = config, parameters
        self._present, self._wrench = Present(config), Wrench(config.vehicle)
        self._filter = Butterworth(parameters.filter_rad_s, config.sampling_time_s)
        self._before: tuple[float, Array, Array] | None = None
        self._filtered = np.zeros((4, 3))

    def step(self, t: float, x: ArrayLike, now: float | None = None) -> OneStepPlan:
        """Decide from the state x measured at t [s], for rotors that answer from ``now`` [s]."""
        now = t if now is None else now
        measured = np.array(x, dtype=float)
        a_0, alpha_0, f_0, tau_0 = self._synchronous(t, measured)
        config, vehicle, by = self.config, self.config.vehicle, self._is
        mass, inertia = vehicle.mass_kg, np.array(vehicle.inertia_kg_m2)
        at = config.helix.at(now, config.tower)
        state, _ = self._present.estimate(t, measured, now)
        actual, omega = rotation_of(state[ATTITUDE]), state[RATE]

        kp, kv = by.position_rad_s**2, 2.0 * by.damping * by.position_rad_s
        far, slow = at.position[0] - state[POSITION], at.velocity[0] - state[VELOCITY]
        wanted = at.acceleration[0] + kp * far + kv * slow
        force = f_0 + mass * (wanted - a_0)

        level = self._wrench.attitude_for(force, float(at.yaw[0]))
        spin = actual.T @ [0.0, 0.0, float(at.yaw_rate[0])] - omega
        k_r, k_w = by.attitude_rad_s**2, 2.0 * by.attitude_rad_s
        turning = k_w * spin - k_r * attitude_error(actual, level)
        torque = tau_0 + inertia * (turning - alpha_0)

        wrench = np.concatenate((actual.T @ force, torque))
        u = self._wrench.rotor_accelerations(wrench, state[ROTORS])
        return self._present.send(t, state, now, u)

    def _synchronous(self, t: float, measured: Array) -> Array:
        """Filter accelerations and wrench of the same time, shape (4, 3).

        Acceleration, world frame [m/s^2], angular acceleration, body frame [rad/s^2], force of the
        rotors, world frame [N], and their torque, body frame [N m].
        """
        force, torque = np.split(self._wrench.of(measured[ROTORS]), 2)
        wrench = np.stack((rotation_of(measured[ATTITUDE]) @ force, torque))
        moving = np.stack((measured[VELOCITY], measured[RATE]))
        if self._before is None:
            # Nothing has been seen yet: the nominal vehicle at hover.
            still = np.zeros((2, 3))
            raw = np.concatenate((still, [self._wrench.hover_force(), still[0]]))
        elif t > self._before[0]:
            before_s, moved, had = self._before
            raw = np.concatenate(((moving - moved) / (t - before_s), 0.5 * (wrench + had)))
        else:
            return self._filtered
        self._before = t, moving, wrench
        self._filtered = self._filter(raw)
        return self._filtered


INDI = Tuned("indi", IndiParameters, Indi)
"""Incremental inversion."""
