# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a flight is made of, and what goes on with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gtmr_guard import Guard
from gtmr_model import Vehicle
from gtmr_sim.gust import Gust
from gtmr_sim.plant import Plant
from gtmr_sim.worlds.sensor import Sensor
from gtmr_sim.worlds.wind import WindField

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plan:
    """Commands for the rotors from a plant step on, one row for each plan step."""

    start: int
    """When the plan begins, in plant steps."""
    u: Array
    """Rotor accelerations [Hz/s], shape (N, N_p)."""
    setpoints_hz: Array | None
    """Rotor speeds at the plan steps [Hz], shape (N + 1, N_p); none if the plan has none."""
    usable: bool
    """Whether it can be sent to the rotors; if not, it has no rows."""


@dataclass
class Parts:
    """What a flight is made of; times are in plant steps."""

    vehicle: Vehicle
    step_s: float
    """The plant step [s]."""
    plan_step: int
    hold: int
    """How long a gust sample is held."""
    sample: int
    """Between two measurements."""
    watch: int
    """Between two checks of the guard while a plan is in charge, at most."""
    act: int
    """Between two of its steps while it is in charge itself, at most."""
    has_motors: bool
    plant: Plant
    gust: Gust
    wind: WindField | None
    """None where wind is the force w_b of zeta."""
    sensor: Sensor | None
    """None where what is measured is the truth."""
    guard: Guard | None
    looked: int
    """When the guard has looked last."""


class Loop(Protocol):
    """A flight in progress, whose time is counted in plant steps.

    It begins at zero, where gusts are drawn and, with a sensor, the state is measured.
    """

    @property
    def step(self) -> int:
        """Time now."""
        ...

    @property
    def plan_start(self) -> int:
        """When the plan in play began."""
        ...

    @property
    def gust_n(self) -> Array:
        """Gust force from now on, world frame [N], shape (3,)."""
        ...

    @property
    def cause(self) -> int:
        """Why the guard is in charge, by its index in `gtmr_guard.CAUSES`."""
        ...

    @property
    def guarded(self) -> int:
        """How long the guard has been in charge."""
        ...

    def play(self, plan: Plan, acts: int) -> None:
        """Play a plan from a time on, now or later; what was to come then or after is no more."""
        ...

    def advance(self, end: int) -> None:
        """Fly on until a time."""
        ...

    def newest(self) -> tuple[int, Array] | None:
        """Give the newest measurement that has arrived: when it was made, and the state."""
        ...

    def replace(
        self,
        plant: Plant | None = None,
        gust: Gust | None = None,
        wind: WindField | None = None,
    ) -> None:
        """Go on with another plant, gust or wind; gusts and wind from their next sample on."""
        ...
