# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What one controller step returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gtmr_nmpc.margins import Tightening

Status = Literal["solved", "softened", "limited", "failed"]
"""How a step ended.

``solved`` and ``softened``, which uses slack, are solutions of the QP. ``limited`` is the plan of
a solver that stopped before its solution, at its bound on passes or where rounding stood in its
way: it keeps the limits of the rotors and tells the slack it uses, but there is a better one.
``failed``: there are no finite numbers, or the reference's solver gave up, and the rest of the
last plan is returned.
"""


@dataclass(frozen=True)
class Timing:
    """Wall-clock time of the two phases of a step."""

    prepare_s: float
    """Linearisation, sensitivities, margins and condensing, before the state is known [s]."""
    feedback_s: float
    """From the measured state to the command [s]."""

    @property
    def total_s(self) -> float:
        """Both phases [s]."""
        return self.prepare_s + self.feedback_s


@dataclass(frozen=True)
class Solution:
    """One controller step: the plan over N stages and the margins it was made with."""

    u: NDArray[np.float64]
    """Rotor accelerations to apply now [Hz/s], shape (N_p,)."""
    x_plan: NDArray[np.float64]
    """Predicted states, shape (N + 1, 12 + N_p)."""
    u_plan: NDArray[np.float64]
    """Planned rotor accelerations [Hz/s], shape (N, N_p)."""
    setpoints_hz: NDArray[np.float64]
    """Speed setpoints of the rotors [Hz] at the stages, linear in between, shape (N + 1, N_p): the
    planned speeds, ahead of them by what motors with the stated lag stay behind."""
    tightening: Tightening
    """The margins of every stage by their parts, as applied; zero in nominal mode."""
    slack: NDArray[np.float64]
    """By how much the plan violates the tightened clearance at each stage [m], shape (N + 1,)."""
    margin_scale: float
    """How much of the margins was applied, and is in ``tightening``: 0 in nominal
    mode, 1 in robust mode, in between for a while after a switch."""
    status: Status
    """``solved``, ``softened``, ``limited`` or ``failed``; see `Status`."""
    timing: Timing
    """How long the step took."""

    @classmethod
    def later(cls, make: Callable[[str], Any], margin_scale: float, status: Status) -> Solution:
        """Make a solution whose other fields are made when they are first asked for.

        ``make`` gives a field by its name, always the same; most users look at few of them.
        """
        solution = object.__new__(cls)
        known = solution.__dict__
        known["_make"], known["margin_scale"], known["status"] = make, margin_scale, status
        return solution

    def __getattr__(self, name: str) -> Any:
        """Make a field that was not asked for before."""
        if name not in FIELDS or "_make" not in self.__dict__:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        value = self.__dict__[name] = self._make(name)
        return value

    def __reduce__(self) -> tuple[type[Solution], tuple[Any, ...]]:
        """Pickle and copy all fields, made or not."""
        return type(self), tuple(getattr(self, name) for name in FIELDS)

    @property
    def alpha_p(self) -> NDArray[np.float64]:
        """Parametric margin per stage, eq. (12), eps_s included [m], shape (N + 1,)."""
        return self.tightening.parametric

    @property
    def alpha_p_by_channel(self) -> NDArray[np.float64]:
        """The terms |Pi_y,i,j| w_bar_j of eq. (12) [m], shape (N + 1, 9)."""
        return self.tightening.by_channel

    @property
    def eps_s(self) -> NDArray[np.float64]:
        """What of alpha_p belongs to no channel [m], shape (N + 1,)."""
        return self.tightening.eps_s

    @property
    def alpha_g(self) -> NDArray[np.float64]:
        """Gust margin per stage, eq. (13) [m], shape (N + 1,); that for noise is in it."""
        return self.tightening.random


FIELDS = tuple(field.name for field in fields(Solution))
"""Names of the fields, in order."""
