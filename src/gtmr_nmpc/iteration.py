# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The interface between a controller and a real-time iteration, which keeps its own iterate."""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gtmr_nmpc.config import ControllerConfig
from gtmr_nmpc.margins import Iterate, Tightening
from gtmr_nmpc.observer import Observer
from gtmr_nmpc.solution import Status

Array = NDArray[np.float64]

SLACK_TOLERANCE_M = 1e-9
"""Slack below this is rounding of the QP solver, not a violation [m]."""


class IterationResult(NamedTuple):
    """What one iteration gives; the fields are those of `Solution`."""

    x_plan: Array
    """Predicted states, shape (N + 1, 12 + N_p)."""
    u_plan: Array
    """Planned rotor accelerations [Hz/s], shape (N, N_p)."""
    tightening: Tightening
    """The margins it was made with."""
    slack: Array
    """Violation of the tightened clearance per stage [m], shape (N + 1,)."""
    status: Status
    """``solved``, ``softened``, ``limited`` or ``failed``."""


class Iteration(Protocol):
    """Gauss-Newton iterations of one problem, from a warm or a cold start."""

    def reconfigure(self, config: ControllerConfig) -> None:
        """Take over other numbers of the same problem, of the same vehicle, horizon and T_s."""
        ...

    def observer(self) -> Observer:
        """Give what estimates disturbances for this problem; one for each controller."""
        ...

    def cold(self, x: Array) -> None:
        """Make the iterate by holding a state, shape (12 + N_p,), for the whole horizon."""
        ...

    def warm(self, steps: int) -> None:
        """Make the iterate from the last plan, moved on by 0 to N - 1 sampling times.

        Past its end the rotors hold their speeds.
        """
        ...

    def disturb(self, theta: Array | None) -> None:
        """Let disturbances act in the model from now on, None for none.

        theta, shape (9,), is that of stage 0; of it the gust force fades along the horizon.
        """
        ...

    def prepare(self, t: float, margin_scale: float) -> None:
        """Do all of the iteration that needs no measurement; stage 0 is at t [s].

        Margins are scaled by 1 in robust mode, 0 in nominal mode, in between after a switch.
        """
        ...

    def linearised(self) -> Iterate:
        """Tell what a margin may depend on, in robust mode and after ``prepare``."""
        ...

    def tighten(self, tightening: Tightening) -> None:
        """Use other margins than the paper's in the step that was prepared."""
        ...

    def feedback(self, x: Array) -> IterationResult:
        """Solve the QP for a measured state, shape (12 + N_p,), and take the full step.

        The state is that of the prepared time, its yaw within pi of the iterate's. The result's
        arrays belong to the caller.
        """
        ...
