# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The real-time iteration on CasADi's virtual machine: no compiler needed, same answers."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gtmr_nmpc.config import ControllerConfig, Mode
from gtmr_nmpc.iteration import SLACK_TOLERANCE_M, IterationResult
from gtmr_nmpc.margins import Iterate, Tightening
from gtmr_nmpc.observer import InterpretedObserver
from gtmr_nmpc.reference.rti import Preparation, RealTimeIteration, Trajectory
from gtmr_nmpc.solution import Status

Array = NDArray[np.float64]


class InterpretedIteration:
    """An `Iteration` made of `RealTimeIteration`."""

    def __init__(self, config: ControllerConfig) -> None:
        self._config = config
        self._rti = RealTimeIteration(config)
        self._iterate: Trajectory
        self._last: Trajectory
        self._preparation: Preparation

    def reconfigure(self, config: ControllerConfig) -> None:
        """See `Iteration.reconfigure`."""
        self._config = config
        self._rti.reconfigure(config)

    def observer(self) -> InterpretedObserver:
        """See `Iteration.observer`."""
        return InterpretedObserver(self._config)

    def cold(self, x: Array) -> None:
        """See `Iteration.cold`."""
        n = self._config.horizon
        self._iterate = Trajectory(
            x=np.tile(x, (n + 1, 1)), u=np.zeros((n, self._config.vehicle.n_rotors))
        )

    def warm(self, steps: int) -> None:
        """See `Iteration.warm`."""
        hold = np.zeros((steps, self._config.vehicle.n_rotors))
        states = list(self._last.x[steps:])
        for stage, u in enumerate(hold, start=len(self._last.u) - steps):
            states.append(self._rti.predict(states[-1], u, stage))
        self._iterate = Trajectory(x=np.array(states), u=np.vstack([self._last.u[steps:], hold]))

    def disturb(self, theta: Array | None) -> None:
        """See `Iteration.disturb`."""
        self._rti.disturb(theta)

    def prepare(self, t: float, margin_scale: float) -> None:
        """See `Iteration.prepare`."""
        mode: Mode = "robust" if margin_scale > 0.0 else "nominal"
        self._preparation = self._rti.prepare(t, self._iterate, mode, margin_scale)

    def linearised(self) -> Iterate:
        """See `Iteration.linearised`."""
        at = self._iterate
        return Iterate(self._config, at.x, at.u, lambda: self._rti.sensitivities(at))

    def tighten(self, tightening: Tightening) -> None:
        """See `Iteration.tighten`."""
        old = self._preparation
        more = (tightening.total - old.margins.total)[1:]
        self._preparation = replace(
            old, margins=tightening, clearance_residual=old.clearance_residual + more
        )

    def feedback(self, x: Array) -> IterationResult:
        """See `Iteration.feedback`."""
        status: Status
        result = self._rti.feedback(self._preparation, x)
        if result is None:
            self._last, slack, status = self._iterate, np.zeros(self._config.horizon), "failed"
        else:
            self._last, slack = result
            status = "softened" if slack.max() > SLACK_TOLERANCE_M else "solved"
        tightening = self._preparation.margins
        # Stage 0 is measured, not planned: its violation is a fact and no variable of the QP.
        y = self._config.clearance_constraint.residual(x[None], self._config.tower)
        now = y + tightening.total[:1]
        return IterationResult(
            x_plan=self._last.x,
            u_plan=self._last.u,
            tightening=tightening,
            slack=np.r_[np.maximum(now, 0.0), slack],
            status=status,
        )
