# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Whether a plan is fit to be sent; if none is, the guard takes charge."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gtmr_model.dynamics import ATTITUDE, VELOCITY
from gtmr_nmpc.solution import Solution

FAILING_S = 0.1
"""How long the solver may fail without interruption; until then the last plan is shifted [s]."""
MAX_SPEED_M_S = 10.0
"""Speed beyond which linear drag and the horizon's linearisation say nothing [m/s]."""


class Fitness:
    """Judges plans one after the other; a reason not to send one is what diagnostics tell.

    A vehicle that is inverted or too fast is beyond the model. One that stays too near the tower
    is the guard's to judge, which sees every instant.
    """

    def __init__(self) -> None:
        self._failing_since_s: float | None = None

    def reason(self, t: float, x: NDArray[np.float64], solution: Solution) -> str:
        """Say why the plan from state x, shape (12 + N_p,), at time t [s] is not fit, if so."""
        if solution.status != "failed":
            self._failing_since_s = None
        elif self._failing_since_s is None or t < self._failing_since_s:
            self._failing_since_s = t
        if self._failing_since_s is not None and t - self._failing_since_s > FAILING_S:
            return f"the QP solver has failed for more than {FAILING_S} s"
        roll, pitch, _ = x[ATTITUDE]
        if math.cos(roll) * math.cos(pitch) < 0.0:
            return "the vehicle is inverted"
        if math.hypot(*x[VELOCITY]) > MAX_SPEED_M_S:
            return f"the vehicle is faster than {MAX_SPEED_M_S} m/s"
        return "" if np.isfinite(solution.u_plan).all() else "the plan has what is no number"
