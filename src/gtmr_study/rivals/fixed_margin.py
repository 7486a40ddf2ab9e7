# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Nominal NMPC that keeps a constant distance more, which is what a practitioner does first.

It assumes that one number covers every mismatch, gust and delay. What it has of the paper's
controller is the same real-time iteration without sensitivities: a step costs as much as a nominal
one. Its margin, the share of the position weights and the price of rotor accelerations are tuned
for each world, so that tracking and margin are traded by the same search as those of every other
rival. Where it breaks: the number is right for the flights it was tuned on, and tells nothing of
others: with a mismatch that grows, or a wind from elsewhere, it is too small where it matters and
too large everywhere else. Its friends say that a margin of a few centimetres does what a formula
does at no cost, on the state of a good filter; so it is tuned close to the constraint as well,
where the formula's margins act, and gets the state of the suite's Kalman filter, of whose
estimated disturbance it makes no use.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from gtmr_nmpc import Controller, ControllerConfig, Solution
from gtmr_nmpc.config import Weights
from gtmr_nmpc.margins import FixedMargin
from gtmr_study.rivals.feedback.present import Present
from gtmr_study.rivals.tuning import RivalParameters, Tuned


class FixedMarginParameters(RivalParameters):
    """What a nominal NMPC with a constant margin is tuned by."""

    margin_m: float = Field(0.02, ge=0.001, le=0.15)
    """By how much every stage is tightened [m]."""
    position_scale: float = Field(20.0, ge=0.5, le=100.0)
    """Factor of the paper's weights on position, at the end of the horizon too [-]."""
    rotor_acceleration: float = Field(2e-6, ge=1e-7, le=1e-3)
    """Q_u [(Hz/s)^-2]."""


def weights(base: Weights, position_scale: float, rotor_acceleration: float) -> Weights:
    """Scale the weights on position [-] and set that on rotor accelerations [(Hz/s)^-2]."""
    scaled = {
        name: tuple(position_scale * weight for weight in getattr(base, name))
        for name in ("position", "terminal_position")
    }
    return base.model_copy(update={**scaled, "rotor_acceleration": rotor_acceleration})


class FixedMarginNmpc:
    """The controller of one flight."""

    def __init__(self, config: ControllerConfig, parameters: FixedMarginParameters) -> None:
        cost = weights(config.weights, parameters.position_scale, parameters.rotor_acceleration)
        margin = FixedMargin(margin_m=parameters.margin_m)
        self.config = config.model_copy(update={"weights": cost, "margin": margin})
        self._present = Present(config)
        self._controller = Controller(self.config, "robust")

    def step(self, t: float, x: ArrayLike, now: float | None = None) -> Solution:
        """Plan from the state x measured at t [s], for rotors that answer from ``now`` [s]."""
        now = t if now is None else now
        state, _ = self._present.estimate(t, np.array(x, dtype=float), now)
        solution = self._controller.step(now, state)
        self._present.send(t, state, now, solution.u)
        return solution


FIXED_MARGIN = Tuned("fixed_margin", FixedMarginParameters, FixedMarginNmpc, constrained=True)
"""Nominal NMPC with a constant margin."""
