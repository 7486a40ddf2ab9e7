# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The condensed QP: hard limits on the rotors, an exact penalty on the clearance."""

from dataclasses import dataclass
from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

UNBOUNDED = 1e30
"""What DAQP takes for infinity."""
OPTIMAL = 1
"""DAQP's exit flag of a solved problem."""
PRIMAL_TOLERANCE = 1e-9
"""By how much DAQP may break a bound, in its units."""


class DaqpProblem(NamedTuple):
    """A QP as DAQP takes it: bounds of the variables first, then of the rows."""

    hessian: Array
    """Shape (n, n)."""
    gradient: Array
    """Shape (n,)."""
    rows: Array
    """Shape (m, n)."""
    upper: Array
    """Shape (n + m,)."""
    lower: Array
    """Shape (n + m,)."""


@dataclass(frozen=True)
class QpSolution:
    """Minimiser of a condensed QP."""

    du: Array
    """Step of the inputs [Hz/s], shape (N N_p,)."""
    slack: Array
    """Violation of each clearance row [m], shape (n_rows,)."""
    multipliers: Array
    """Multipliers of the clearance rows [1/m], shape (n_rows,)."""


@dataclass(frozen=True)
class CondensedQp:
    """1/2 du' H du + g' du, subject to box, rotor speed rows and soft clearance rows."""

    hessian: Array
    """H, positive definite, shape (n, n)."""
    gradient: Array
    """g, shape (n,)."""
    input_lower: Array
    """Lower bounds of du [Hz/s], shape (n,)."""
    input_upper: Array
    """Upper bounds of du [Hz/s], shape (n,)."""
    speed_rows: Array
    """Rows that give the change of planned rotor speeds [s], shape (m, n)."""
    speed_lower: Array
    """Lower bounds of the rotor speed rows [Hz], shape (m,)."""
    speed_upper: Array
    """Upper bounds of the rotor speed rows [Hz], shape (m,)."""
    clearance_rows: Array
    """Rows of the linearised clearance constraint [m/(Hz/s)], shape (k, n)."""
    clearance_upper: Array
    """Their upper bounds [m], shape (k,)."""
    slack_l1: float
    """Linear penalty per slack [1/m]."""
    slack_l2: float
    """Quadratic penalty per slack [1/m^2]."""

    def solve(self) -> QpSolution | None:
        """Minimise with DAQP; None if the solver gave up.

        The problem is first solved with the clearance as hard rows. While their multipliers stay
        below the linear penalty this also minimises the exact-penalty problem; only else are slack
        variables brought in, which makes the problem several times dearer.
        """
        hard = self._solve_hard()
        if hard is not None and hard.multipliers.max(initial=0.0) <= self.slack_l1:
            return hard
        return self._solve_soft()

    def hard(self) -> DaqpProblem:
        """State it with the clearance as hard rows, in du alone."""
        return DaqpProblem(
            self.hessian,
            self.gradient,
            np.vstack([self.speed_rows, self.clearance_rows]),
            np.r_[self.input_upper, self.speed_upper, self.clearance_upper],
            np.r_[self.input_lower, self.speed_lower, self._no_lower_clearance],
        )

    def soft(self) -> DaqpProblem:
        """State it with a slack for each clearance row, in du and slacks."""
        n, m, k = len(self.gradient), len(self.speed_upper), len(self.clearance_upper)
        hessian = np.zeros((n + k, n + k))
        hessian[:n, :n] = self.hessian
        hessian[n:, n:] = 2.0 * self.slack_l2 * np.eye(k)
        rows = np.zeros((m + k, n + k))
        rows[:m, :n] = self.speed_rows
        rows[m:, :n] = self.clearance_rows
        rows[m:, n:] = -np.eye(k)
        return DaqpProblem(
            hessian,
            np.r_[self.gradient, np.full(k, self.slack_l1)],
            rows,
            np.r_[self.input_upper, np.full(k, UNBOUNDED), self.speed_upper, self.clearance_upper],
            np.r_[self.input_lower, np.zeros(k), self.speed_lower, self._no_lower_clearance],
        )

    @property
    def _no_lower_clearance(self) -> Array:
        return np.full(len(self.clearance_upper), -UNBOUNDED)

    def _solve_hard(self) -> QpSolution | None:
        minimiser, _, flag, info = daqp.solve(*self.hard(), primal_tol=PRIMAL_TOLERANCE)
        if flag != OPTIMAL:
            return None
        n, m, k = len(self.gradient), len(self.speed_upper), len(self.clearance_upper)
        return QpSolution(du=minimiser, slack=np.zeros(k), multipliers=info["lam"][n + m :])

    def _solve_soft(self) -> QpSolution | None:
        minimiser, _, flag, info = daqp.solve(*self.soft(), primal_tol=PRIMAL_TOLERANCE)
        if flag != OPTIMAL:
            return None
        n, m, k = len(self.gradient), len(self.speed_upper), len(self.clearance_upper)
        slack = np.maximum(minimiser[n:], 0.0)
        return QpSolution(du=minimiser[:n], slack=slack, multipliers=info["lam"][n + k + m :])
