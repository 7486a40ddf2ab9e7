# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The paper's margin to second order, which its conclusion names as future work."""

from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model import N_ZETA, Vehicle
from gtmr_model.airframe import CENTRE
from gtmr_model.dynamics import POSITION, ROTORS, discrete_step, one_at_a_time, symbols
from gtmr_nmpc.margins.margin import Iterate, Margin, Tightening
from gtmr_nmpc.margins.paper import PaperMargin

Array = NDArray[np.float64]

BODY = ROTORS.start
"""States that zeta reaches."""


class SecondOrderMargin(Margin):
    """Eq. (12) with the second-order terms of the clearance in zeta, each by its magnitude.

    sum_j |y_j| w_j + 1/2 sum_jk |y_jk| w_j w_k bounds the second-order expansion over the whole
    box. What is left is the rest of the series of 1 / (1 + d_m), which is geometric: dividing the
    second-order terms by 1 - w_m covers it. Evaluated with CasADi, it takes milliseconds a step.
    """

    kind: str = "second-order"
    """Which margin."""

    def tightening(self, iterate: Iterate) -> Tightening:
        """Share each second-order term between its two channels."""
        first, box = PaperMargin().tightening(iterate), iterate.config.uncertainty
        products = 0.5 * np.outer(box.half_widths, box.half_widths) / (1.0 - box.mass)
        second = np.abs(second_order_clearance(iterate)) * products
        by_channel = first.by_channel + second.sum(axis=2)
        return Tightening(by_channel, first.eps_s, first.gust)


def second_order_clearance(iterate: Iterate) -> Array:
    """d^2 y / d zeta^2 of the clearance constraint along a plan [m], shape (N + 1, 9, 9)."""
    config, x = iterate.config, iterate.x
    step = _second_order_step(config.vehicle, config.sampling_time_s, config.horizon)
    jacobians, hessians = (np.asarray(block) for block in step(x[:-1].T, iterate.u.T))
    n, pi = config.horizon, iterate.Pi[:, :BODY]
    jacobians = jacobians.reshape(BODY, n, BODY)
    size = BODY + N_ZETA
    hessians = hessians.reshape(BODY, size, n, size)
    second = np.zeros((n + 1, BODY, N_ZETA, N_ZETA))
    for i in range(n):
        along = np.vstack([pi[i], np.eye(N_ZETA)])
        bent = np.einsum("rab,aj,bk->rjk", hessians[:, :, i], along, along, optimize=True)
        second[i + 1] = np.einsum("rs,sjk->rjk", jacobians[:, i], second[i]) + bent
    gradient = CENTRE.gradient(x)
    by_position = np.einsum("ip,ipjk->ijk", gradient, second[:, POSITION])
    return by_position + _turning(x[:, POSITION], pi[:, POSITION])


def _turning(positions: Array, pi: Array) -> Array:
    """Add what the curvature of the tower does: y = R + d_min - rho, shape (N + 1, 9, 9)."""
    rho = np.hypot(positions[:, 0], positions[:, 1])
    across = np.stack([-positions[:, 1], positions[:, 0]], axis=1) / rho[:, None]
    sideways = np.einsum("ip,ipj->ij", across, pi[:, :2])
    return np.asarray(-np.einsum("ij,ik->ijk", sideways, sideways) / rho[:, None, None])


@lru_cache(maxsize=8)
@one_at_a_time
def _second_order_step(vehicle: Vehicle, step_s: float, stages: int) -> ca.Function:
    """(x, u) of all stages -> dF/dx and the second derivatives of F in (x, zeta), of the body."""
    x, u, zeta, no_gust = symbols(vehicle)
    x_next = discrete_step(x, u, zeta, no_gust, vehicle, step_s)[:BODY]
    free = ca.vertcat(x[:BODY], zeta)
    first = ca.jacobian(x_next, free)
    second = [ca.jacobian(first[r, :], free) for r in range(BODY)]
    results = [first[:, :BODY], ca.vertcat(*second)]
    nominal = [ca.vertcat(zeta, no_gust)], [ca.DM.zeros(N_ZETA + 3)]
    results = [ca.densify(r) for r in ca.substitute(results, *nominal)]
    return ca.Function("second_order", [x, u], ca.cse(results)).map(stages)
