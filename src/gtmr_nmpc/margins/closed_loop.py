# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The margin of a loop with feedback: deviations of the closed loop from its plans."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gtmr_nmpc.margins.margin import Iterate, Margin, Tightening, tightening_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Deviations:
    """How far a flight may be from a plan's clearance at stages 0..N, by cause."""

    gust: Array
    """Most that gusts within their bound can do [m], shape (N + 1,)."""
    noise: Array
    """Standard deviation for the stated noise [m], shape (N + 1,)."""
    transient: Array
    """What each channel of zeta, at its bound, does k steps after the estimates began [m], shape
    (K, N + 1, 9); nothing after that."""


class ClosedLoopMargin(Margin):
    """L1 norm of the closed loop for gusts, a quantile for noise, and what is not learnt yet."""

    kind: str = "closed-loop"
    """Which margin."""
    noise_sigmas: float = Field(4.0, ge=0.0, le=10.0)
    """Quantile of the noise, in standard deviations [-]."""
    eps_s_m: float = Field(1e-3, ge=0.0)
    """What a linear closed loop leaves out [m]."""

    def tightening(self, iterate: Iterate) -> Tightening:
        """Depend on how long disturbances have been estimated, and not on the plan."""
        at, stages = iterate.deviations(), len(iterate.x)
        k = iterate.observed_steps
        transient = at.transient[k] if k < len(at.transient) else np.zeros_like(at.transient[0])
        return Tightening(
            transient, np.full(stages, self.eps_s_m), at.gust, self.noise_sigmas * at.noise
        )

    def by_steps(self, config: Any, deviations: Deviations) -> list[Tightening]:
        """Give the tightening of every step since disturbances began to be estimated.

        The last one is for all steps after it, too; ``config`` is a `ControllerConfig`.
        """
        no_plan = np.zeros((config.horizon + 1, 1))
        at = Iterate(config, no_plan, no_plan[1:], lambda: no_plan, lambda: deviations)
        steps = range(len(deviations.transient) + 1)
        return [tightening_of(self, replace(at, observed_steps=k)) for k in steps]
