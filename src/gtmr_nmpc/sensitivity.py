# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Parametric sensitivities Pi = dx/dzeta along a plan, eq. (7) and (8)."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model.airframe import CENTRE, ClearanceConstraint
from gtmr_model.uncertainty import N_ZETA

Array = NDArray[np.float64]


def propagate(dF_dx: Array, dF_dzeta: Array) -> Array:
    """Discrete map F_Pi consistent with the RK4 step: Pi_{i+1} = dF/dx Pi_i + dF/dzeta.

    Differentiating the discrete step, not the ODE, makes Pi the exact sensitivity of the plan.
    Jacobians along the plan have shapes (N, n_x, n_x) and, at zeta_0 = 0, (N, n_x, 9); Pi_0..Pi_N
    have (N + 1, n_x, 9), with Pi_0 = 0 (eq. 15f).
    """
    n, n_x, _ = dF_dzeta.shape
    pi = np.zeros((n + 1, n_x, N_ZETA))
    for i in range(n):
        pi[i + 1] = dF_dx[i] @ pi[i] + dF_dzeta[i]
    return pi


def clearance_sensitivity(x: Array, pi: Array, constraint: ClearanceConstraint = CENTRE) -> Array:
    """Sensitivity of the clearance constraint, Pi_y = J_yx Pi [m] per unit of zeta.

    Planned states, shape (N + 1, n_x) or as many of the first as the constraint depends on, and
    Pi, shape (N + 1, n_x, 9), give shape (N + 1, 9).
    """
    by_state = pi[:, : constraint.length, :]
    sensitivity: Array = np.einsum("ij,ijk->ik", constraint.gradient(x), by_state)
    return sensitivity


def second_order_adjoint(dynamics: ca.Function) -> ca.Function:
    """(x, u, lambda, pi, s) -> gradient of lambda^T (dF/dx pi + dF/dzeta s) in x and u.

    It is how one step's contribution to a margin changes with the plan; summed over the steps it
    gives the gradient of alpha_p, shape (n_x + N_p,), without carrying Pi as states.
    """
    x, u, zeta = (ca.SX.sym(name, dynamics.size1_in(name)) for name in ("x", "u", "zeta"))
    lam, pi = ca.SX.sym("lambda", x.numel()), ca.SX.sym("pi", x.numel())
    s = ca.SX.sym("s", zeta.numel())
    x_next = dynamics(x, u, zeta)
    directional = ca.jtimes(x_next, ca.vertcat(x, zeta), ca.vertcat(pi, s))
    gradient = ca.gradient(ca.dot(lam, directional), ca.vertcat(x, u))
    gradient = ca.substitute(gradient, zeta, ca.DM.zeros(zeta.numel()))
    return ca.Function("adjoint", [x, u, lam, pi, s], [ca.densify(gradient)])
