# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the families of robust MPC share in flight: a filtered state, brought up to now."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_model.dynamics import YAW
from gtmr_nmpc import ControllerConfig
from gtmr_study.rivals.feedback.present import OneStepPlan, Present

Array = NDArray[np.float64]


class Filtered(ABC):
    """Plans from the state of `Present`, and sends the first input.

    The disturbance that its filter finds serves to filter and to predict over the delay; the plan
    does not get it, since these families guard against a set and learn nothing.
    """

    def __init__(self, config: ControllerConfig) -> None:
        self.config = config
        self._present = Present(config)

    @abstractmethod
    def plan(self, now: float, x: Array) -> Array:
        """Choose rotor accelerations [Hz/s], shape (N_p,), for state x, shape (12 + N_p,)."""

    def step(self, t: float, x: ArrayLike, now: float | None = None) -> OneStepPlan:
        """Decide from the state x measured at t [s], for rotors that answer from ``now`` [s]."""
        now = t if now is None else now
        state, _ = self._present.estimate(t, np.array(x, dtype=float), now)
        return self._present.send(t, state, now, self.plan(now, state))


def near(yaw_rad: float, state: Array) -> Array:
    """Give a state whose yaw is within half a turn of another [rad]."""
    x = state.copy()
    x[YAW] -= 2.0 * np.pi * round((x[YAW] - yaw_rad) / (2.0 * np.pi))
    return x
