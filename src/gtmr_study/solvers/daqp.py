# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""DAQP on the QPs of the controller."""

import daqp
import numpy as np
from numpy.typing import NDArray

from gtmr_nmpc import ControllerConfig
from gtmr_nmpc.reference.qp import OPTIMAL, PRIMAL_TOLERANCE, DaqpProblem
from gtmr_nmpc.reference.rti import RealTimeIteration
from gtmr_study.solvers.qp import REPEATS, RecordedStep

Array = NDArray[np.float64]

ACTIVE, LOWER = 1, 2
"""DAQP's marks of a row that it starts with, and of one at its lower bound."""


class DaqpRival:
    """DAQP on the dense QP in inputs, condensed and stated as `gtmr_nmpc.reference.qp` does.

    With hard clearance rows, and with slacks only where these do not suffice; the times of both
    count. It starts from the rows active at the last step, moved on by a stage. Its time is that
    of its set-up, which factorises the Hessian, and of its solution.
    """

    def __init__(self, config: ControllerConfig) -> None:
        self._n, self._n_u = config.horizon, config.vehicle.n_rotors
        self._rti = RealTimeIteration(config)
        self.start()

    def start(self) -> None:
        """See `QpRival.start`."""
        self._marks: dict[int, NDArray[np.int32]] = {}

    def solve(self, step: RecordedStep) -> tuple[Array, float]:
        """See `QpRival.solve`."""
        prep = self._rti.prepare(step.t, step.iterate, step.mode)
        qp = self._rti.condensed(prep, step.x)
        first, seconds, multipliers = self._timed(qp.hard())
        clearances = multipliers[-self._n :]
        if first is None or clearances.max() > qp.slack_l1:
            first, more, _ = self._timed(qp.soft())
            seconds += more
        if first is None:
            raise RuntimeError("DAQP gave up")
        return step.iterate.u[0] + first, seconds

    def _timed(self, problem: DaqpProblem) -> tuple[Array | None, float, Array]:
        """Solve a QP: step of the first input, time [s] and multipliers.

        With slacks a QP has more variables than without, and a start of its own.
        """
        variables = len(problem.gradient)
        marks = self._marks.get(variables, np.zeros(len(problem.upper), np.int32))
        runs = [
            daqp.solve(*problem, marks.copy(), primal_tol=PRIMAL_TOLERANCE) for _ in range(REPEATS)
        ]
        minimiser, _, flag, info = runs[0]
        multipliers = np.asarray(info["lam"])
        moved_on = self._moved_on(multipliers, variables)
        active = ACTIVE * (moved_on != 0.0) + LOWER * (moved_on < 0.0)
        self._marks[variables] = active.astype(np.int32)
        seconds = min(told["setup_time"] + told["solve_time"] for *_, told in runs)
        return (minimiser[: self._n_u] if flag == OPTIMAL else None), seconds, multipliers

    def _moved_on(self, multipliers: Array, variables: int) -> Array:
        """Multipliers one stage on: of inputs, slacks where there are any, speeds, clearances."""
        inputs = self._n * self._n_u
        parts = np.split(multipliers, np.cumsum([inputs, variables - inputs, inputs]))
        widths = (self._n_u, 1, self._n_u, 1)
        moved = [
            np.r_[part[width:], np.zeros(min(width, len(part)))]
            for part, width in zip(parts, widths, strict=True)
        ]
        return np.concatenate(moved)
