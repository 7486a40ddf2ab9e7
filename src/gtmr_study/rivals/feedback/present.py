# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The state from which a feedback acts: brought from the stamp of odometry up to now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gtmr_model.dynamics import ROTORS
from gtmr_nmpc import ControllerConfig
from gtmr_nmpc.controller import fastest_iteration
from gtmr_nmpc.observer import Estimate
from gtmr_nmpc.online.sent import Sent, setpoints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OneStepPlan:
    """What a feedback sends: one sampling time of a plan."""

    u_plan: Array
    """Rotor accelerations [Hz/s], shape (1, N_p)."""
    setpoints_hz: Array
    """Speed setpoints at its start and end, ahead of motors that lag [Hz], shape (2, N_p)."""


class Present:
    """What a controller without a plan knows of the present, and what it sent.

    Everybody is told of the noise, the delay and the motors of the world, as the NMPC is, and gets
    the same remedies: the suite's observer, a constant-gain Kalman filter, and the prediction by
    the nominal model with the rotor speeds that were sent.
    """

    def __init__(self, config: ControllerConfig) -> None:
        self._config = config
        self._observer = fastest_iteration(config).observer()
        self._sent = Sent(config)
        self._stamp_s: float | None = None

    def estimate(self, t: float, x: Array, now: float) -> Estimate:
        """Filter a state measured at t [s], and predict it up to ``now`` [s].

        With it comes theta, the force beyond the nominal model, persistent and gust, world frame
        [N], and torque, body frame [N m], shape (9,).
        """
        dt_s = 0.0 if self._stamp_s is None else t - self._stamp_s
        self._stamp_s = t
        filtered, theta = self._observer.update(x, dt_s)
        return Estimate(self._sent.ahead(self._observer, filtered, t, now), theta)

    def send(self, t: float, x: Array, now: float, u: Array) -> OneStepPlan:
        """Command rotor accelerations u [Hz/s], shape (N_p,), at the state of ``now`` [s]."""
        config, vehicle = self._config, self._config.vehicle
        most = vehicle.max_rotor_acceleration_hz_s
        u = np.clip(u, -most, most)
        speeds = np.zeros((2, len(x)))
        speeds[:, ROTORS] = x[ROTORS]
        speeds[1, ROTORS] += config.sampling_time_s * u
        plan = u[None]
        ahead_hz = setpoints(config, speeds, plan)
        self._sent.add(now, t, plan, ahead_hz)
        return OneStepPlan(plan, ahead_hz)
