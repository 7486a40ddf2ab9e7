# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The plans that were sent, and the state that they have led to since a measurement."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gtmr_model.dynamics import ROTORS
from gtmr_nmpc.config import ControllerConfig
from gtmr_nmpc.observer import Observer

Array = NDArray[np.float64]

SHORTEST_S = 1e-6
"""Pieces of time below this are rounding [s]."""


@dataclass(frozen=True)
class _Plan:
    """What was sent at ``start_s``: rotor accelerations and speed setpoints by stages."""

    start_s: float
    u: Array
    setpoints_hz: Array


class Sent:
    """The plans that were sent recently."""

    def __init__(self, config: ControllerConfig) -> None:
        self._plans: deque[_Plan] = deque()
        self.reconfigure(config)

    def reconfigure(self, config: ControllerConfig) -> None:
        """Take over other motors."""
        self._config = config

    def reset(self) -> None:
        """Forget all plans."""
        self._plans.clear()

    def add(self, start_s: float, oldest_s: float, u_plan: Array, setpoints_hz: Array) -> None:
        """Remember a plan that acts from ``start_s`` on, and what acted at ``oldest_s`` [s]."""
        while self._plans and self._plans[-1].start_s >= start_s:
            self._plans.pop()
        self._plans.append(_Plan(start_s, u_plan, setpoints_hz))
        while len(self._plans) > 1 and self._plans[1].start_s <= oldest_s:
            self._plans.popleft()

    def ahead(self, observer: Observer, x: Array, t: float, now: float) -> Array:
        """Predict a state, shape (12 + N_p,), from its stamp t to ``now`` [s]."""
        while now - t > SHORTEST_S:
            plan = next((p for p in reversed(self._plans) if p.start_s <= t + SHORTEST_S), None)
            later = [p.start_s for p in self._plans if p.start_s > t + SHORTEST_S]
            end = min([now, *later])
            if plan is None:
                x, t = observer.ahead(x, x[ROTORS], end - t), end
                continue
            period_s = self._config.sampling_time_s
            stage = math.floor((t - plan.start_s + SHORTEST_S) / period_s)
            if stage < len(plan.u):
                end = min(end, plan.start_s + (stage + 1) * period_s)
            into = (t - plan.start_s) / period_s - stage
            xi = self._rotors(plan, x[ROTORS], stage, into, end - t)
            x, t = observer.ahead(x, xi, end - t), end
        return x

    def _rotors(self, plan: _Plan, xi: Array, stage: int, into: float, dt_s: float) -> Array:
        """Where speeds [Hz] go in a part of a stage of a plan, which may be over."""
        config, vehicle = self._config, self._config.vehicle
        lag_s = config.motor_lag_s
        if stage >= len(plan.u):
            first = last = plan.setpoints_hz[-1] if lag_s > 0.0 else xi
        elif lag_s > 0.0:
            span = plan.setpoints_hz[stage + 1] - plan.setpoints_hz[stage]
            first = plan.setpoints_hz[stage] + into * span
            last = first + span * (dt_s / config.sampling_time_s)
        else:
            first, last = xi, xi + dt_s * plan.u[stage]
        if lag_s > 0.0:
            # A first-order lag behind a ramp.
            behind = lag_s * (last - first) / dt_s
            last = last - behind + (xi - first + behind) * math.exp(-dt_s / lag_s)
        most = vehicle.max_rotor_acceleration_hz_s * dt_s
        last = xi + np.clip(last - xi, -most, most)
        # A rotor outside its limits is taken as it is.
        low = np.minimum(vehicle.min_rotor_speed_hz, xi)
        return np.asarray(np.clip(last, low, np.maximum(vehicle.max_rotor_speed_hz, xi)))


def setpoints(config: ControllerConfig, x_plan: Array, u_plan: Array) -> Array:
    """Speed setpoints [Hz] that make lagging motors follow a plan, shape (N + 1, N_p).

    A motor that follows its setpoint s by xi' = (s - xi) / T has the planned speed if s = xi + T
    u; between the stages both are linear, and of a plan it is the first stage that is flown.
    """
    speeds = x_plan[:, ROTORS].copy()
    if config.motor_lag_s > 0.0:
        speeds[0] += config.motor_lag_s * u_plan[0]
        speeds[1:] += config.motor_lag_s * u_plan
        vehicle = config.vehicle
        np.clip(speeds, vehicle.min_rotor_speed_hz, vehicle.max_rotor_speed_hz, out=speeds)
    return speeds
