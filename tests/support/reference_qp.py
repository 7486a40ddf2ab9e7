# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The condensed QP solved by qpOASES, from an independent hand."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from gtmr_nmpc.reference.qp import CondensedQp, QpSolution


@lru_cache(maxsize=8)
def _qpoases(n: int, m: int) -> ca.Function:
    return ca.conic(
        "qpoases",
        "qpoases",
        {"h": ca.Sparsity.dense(n, n), "a": ca.Sparsity.dense(m, n)},
        {
            "printLevel": "none",
            "sparse": False,
            "nWSR": 5000,
            "terminationTolerance": 1e-12,
            "boundTolerance": 1e-12,
            "enableRegularisation": False,
        },
    )


def solve_with_qpoases(qp: CondensedQp) -> QpSolution:
    """Minimise with a slack variable for each clearance row, in units that suit their penalty."""
    n, m, k = len(qp.gradient), len(qp.speed_upper), len(qp.clearance_upper)
    unit_m = 1e-2
    hessian = np.zeros((n + k, n + k))
    hessian[:n, :n] = qp.hessian
    hessian[n:, n:] = 2.0 * qp.slack_l2 * unit_m**2 * np.eye(k)
    # Rows of the first stages have tiny coefficients: scaled, their tolerance means something.
    scale = 1.0 / np.linalg.norm(qp.clearance_rows, axis=1)
    rows = np.zeros((m + k, n + k))
    rows[:m, :n] = qp.speed_rows
    rows[m:, :n] = scale[:, None] * qp.clearance_rows
    rows[m:, n:] = -unit_m * np.diag(scale)
    solver = _qpoases(n + k, m + k)
    solution = solver(
        h=hessian,
        g=np.r_[qp.gradient, np.full(k, qp.slack_l1 * unit_m)],
        a=rows,
        lbx=np.r_[qp.input_lower, np.zeros(k)],
        ubx=np.r_[qp.input_upper, np.full(k, np.inf)],
        lba=np.r_[qp.speed_lower, np.full(k, -np.inf)],
        uba=np.r_[qp.speed_upper, scale * qp.clearance_upper],
    )
    assert solver.stats()["success"], solver.stats()
    x = np.asarray(solution["x"]).ravel()
    return QpSolution(du=x[:n], slack=unit_m * x[n:], multipliers=np.zeros(k))
