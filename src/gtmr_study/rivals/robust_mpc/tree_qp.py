# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The QP of a scenario tree: condensed QPs of all branches that share their first inputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

from gtmr_nmpc.reference.qp import OPTIMAL, PRIMAL_TOLERANCE, UNBOUNDED, CondensedQp

Array = NDArray[np.float64]

MAX_PASSES = 30
"""Of broken rows that enter, after which the last point is taken."""
ROW_TOLERANCE = 1e-7
"""By how much a row may be broken, in its own units [m, Hz, Hz/s]."""


DEPENDENT = 1e-9
"""Share of a row that is no new direction [-]."""


class _Row(NamedTuple):
    """A row of the constraints, row <= bound."""

    name: tuple[int, int]
    row: Array
    bound: float
    is_soft: bool


class TreeQp:
    """Mean of the branches' costs, all branches' constraints, one set of first inputs.

    Few of the rows hold the solution. They enter when the point so far breaks them: with H
    factorised once, each pass is a small QP in as many variables as rows have entered. A point
    that breaks none is the minimiser of the whole.
    """

    def __init__(self, branches: Sequence[CondensedQp], common: int) -> None:
        self._branches, n = branches, len(branches[0].gradient)
        own = n - common
        self._size = common + len(branches) * own
        self._at = [
            np.r_[0:common, common + k * own : common + (k + 1) * own]
            for k in range(len(branches))
        ]
        share = 1.0 / len(branches)
        self._hessian = np.zeros((self._size, self._size))
        self._gradient = np.zeros(self._size)
        for at, qp in zip(self._at, branches, strict=True):
            self._hessian[np.ix_(at, at)] += share * qp.hessian
            self._gradient[at] += share * qp.gradient
        self._l1, self._l2 = share * branches[0].slack_l1, share * branches[0].slack_l2

    def solve(self) -> list[Array]:
        """Minimise: steps of the inputs of each branch [Hz/s], shape (N N_p,) each."""
        # Imported here, as it takes longer than all else of a flight's start.
        from scipy.linalg import solve_triangular

        root = np.linalg.cholesky(self._hessian)

        def back(v: Array) -> Array:
            return np.asarray(solve_triangular(root, v, lower=True, trans="T"))

        free = point = -back(solve_triangular(root, self._gradient, lower=True))
        known: set[tuple[int, int]] = set()
        limits, soft = np.zeros(0), np.zeros(0, dtype=bool)
        # Directions that the rows so far push along, orthonormal, and the rows in their terms.
        basis, rows = np.zeros((self._size, 0)), np.zeros((0, 0))
        for _ in range(MAX_PASSES):
            broken = [row for row in self._broken(point) if row.name not in known]
            if not broken:
                break
            known.update(row.name for row in broken)
            more = np.array([row.row for row in broken])
            limits = np.append(limits, [row.bound for row in broken] - more @ free)
            soft = np.append(soft, [row.is_soft for row in broken])
            basis, rows = _with(basis, rows, solve_triangular(root, more.T, lower=True))
            point = free + back(basis @ self._closest(rows, limits, soft))
        return [point[at] for at in self._at]

    def _closest(self, rows: Array, limits: Array, soft: NDArray[np.bool_]) -> Array:
        """Find the z of least norm with rows z <= limits, where soft rows cost what is beyond."""
        n, k = rows.shape[1], int(soft.sum())
        slacks = np.zeros((len(rows), k))
        slacks[np.flatnonzero(soft), np.arange(k)] = -1.0
        free = np.full(n, UNBOUNDED)
        minimiser, _, flag, _ = daqp.solve(
            np.diag(np.r_[np.ones(n), np.full(k, 2.0 * self._l2)]),
            np.r_[np.zeros(n), np.full(k, self._l1)],
            np.hstack([rows, slacks]),
            np.r_[free, np.full(k, UNBOUNDED), limits],
            np.r_[-free, np.zeros(k), np.full(len(rows), -UNBOUNDED)],
            primal_tol=PRIMAL_TOLERANCE,
        )
        if flag != OPTIMAL:
            raise RuntimeError(f"DAQP gave up on the tree's QP: {flag}")
        return np.asarray(minimiser[:n])

    def _broken(self, point: Array) -> Iterator[_Row]:
        """Find rows of all branches that a point breaks."""
        for k, (at, qp) in enumerate(zip(self._at, self._branches, strict=True)):
            du = point[at]
            speeds, clearances = qp.speed_rows @ du, qp.clearance_rows @ du
            excess = np.concatenate(
                [
                    du - qp.input_upper,
                    qp.input_lower - du,
                    speeds - qp.speed_upper,
                    qp.speed_lower - speeds,
                    clearances - qp.clearance_upper,
                ]
            )
            for i in np.flatnonzero(excess > ROW_TOLERANCE).tolist():
                own, bound, is_soft = _row(qp, i)
                row = np.zeros(self._size)
                row[at] = own
                yield _Row((k, i), row, bound, is_soft)


def _with(basis: Array, rows: Array, directions: Array) -> tuple[Array, Array]:
    """Take more rows into an orthonormal basis: the basis, and all rows in its terms."""
    from scipy.linalg import qr

    # Rows that depend on others bring no direction, but rounding.
    scale = np.linalg.norm(directions, axis=0)
    rest = directions / scale
    for _ in range(2):
        rest -= basis @ (basis.T @ rest)
    added, upper, _ = qr(rest, mode="economic", pivoting=True)
    added = added[:, np.abs(np.diag(upper)) > DEPENDENT]
    added = np.linalg.qr(added - basis @ (basis.T @ added))[0]
    grown = np.hstack([basis, added])
    above = np.zeros((len(rows), added.shape[1]))
    return grown, np.vstack([np.hstack([rows, above]), directions.T @ grown])


def _row(qp: CondensedQp, i: int) -> tuple[Array, float, bool]:
    """Give row i of a branch as row <= bound, and whether it is soft."""
    n, m = len(qp.gradient), len(qp.speed_upper)
    for sign, upper in ((1.0, qp.input_upper), (-1.0, -qp.input_lower)):
        if i < n:
            row = np.zeros(n)
            row[i] = sign
            return row, float(upper[i]), False
        i -= n
    for sign, upper in ((1.0, qp.speed_upper), (-1.0, -qp.speed_lower)):
        if i < m:
            return sign * qp.speed_rows[i], float(upper[i]), False
        i -= m
    return qp.clearance_rows[i], float(qp.clearance_upper[i]), True
