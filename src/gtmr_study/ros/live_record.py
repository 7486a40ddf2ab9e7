# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the live page keeps of a flight, to go back to any moment of it."""

import bisect
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_MOMENTS = 4000
"""How many moments of a flight are kept; of a long one fewer a second."""


@dataclass(frozen=True)
class Moment:
    """What was drawn at one time of a flight."""

    time_s: float
    """Since the start of the flight [s]."""
    mode: str
    """That of the controller."""
    body: Array
    """State [p, eta, v, omega] in SI units, p and v in the world frame, shape (12,)."""
    xi: Array
    """Rotor speeds [Hz], shape (N_p,)."""
    planned: Array
    """Positions of the plan, world frame [m], shape (N + 1, 3)."""
    margins_m: Array
    """By how much the clearance is tightened at each stage [m], shape (N + 1,)."""


@dataclass
class FlightRecord:
    """The moments of a flight of ``duration_s`` [s], in order."""

    duration_s: float
    moments: list[Moment] = field(default_factory=list)

    def add(self, moment: Moment) -> None:
        """Keep a moment, unless it is too close behind the last one kept."""
        least_s = self.duration_s / MOST_MOMENTS
        if not self.moments or moment.time_s - self.moments[-1].time_s >= least_s:
            self.moments.append(moment)

    def at(self, time_s: float) -> Moment | None:
        """Return the last moment up to a time [s], or the first; None before there is any."""
        if not self.moments:
            return None
        k = bisect.bisect_right([moment.time_s for moment in self.moments], time_s)
        return self.moments[max(k - 1, 0)]
