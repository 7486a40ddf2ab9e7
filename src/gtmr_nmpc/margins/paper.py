# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The clearance constraint and its tightening: eq. (9), (12), (13)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gtmr_model import Tower, UncertaintySet, Vehicle
from gtmr_nmpc import ocp

Array = NDArray[np.float64]

ZERO_MARGIN_M = 1e-12
"""Terms of alpha_p below this are zero by symmetry, as in hover, and their sign is rounding's."""


def clearance_sensitivity(positions: Array, pi: Array) -> Array:
    """Sensitivity of the clearance constraint, Pi_y = J_yx Pi.

    Parameters
    ----------
    positions : NDArray, shape (N + 1, 3)
        Planned positions, world frame [m].
    pi : NDArray, shape (N + 1, n_x, 9)
        State sensitivities.

    Returns
    -------
    NDArray, shape (N + 1, 9)
        [m] per unit of zeta.
    """
    sensitivity: Array = np.einsum("ij,ijk->ik", ocp.clearance_gradient(positions), pi[:, :3, :])
    return sensitivity


def parametric_margin(pi_y: Array, uncertainty: UncertaintySet) -> Array:
    """Terms of the parametric margin by channel, |Pi_y,i,j| w_bar_j of eq. (12), without eps_s.

    Parameters
    ----------
    pi_y : NDArray, shape (N + 1, 9)
        Sensitivity of the clearance constraint.
    uncertainty : UncertaintySet
        The box of zeta.

    Returns
    -------
    NDArray, shape (N + 1, 9)
        [m]; alpha_p is the sum over channels plus eps_s.
    """
    return np.abs(pi_y) * uncertainty.half_widths


def worst_vertex(pi_y: Array, uncertainty: UncertaintySet) -> Array:
    """Offset zeta that maximises Pi_y zeta over the box, the gradient of its maximum in Pi_y.

    At Pi_y,j = 0 that gradient jumps: it takes 0, which is between its values on both sides.

    Parameters
    ----------
    pi_y : NDArray, shape (N + 1, 9)
        Sensitivity of the clearance constraint.
    uncertainty : UncertaintySet
        The box of zeta.

    Returns
    -------
    NDArray, shape (N + 1, 9)
        zeta.
    """
    counts = parametric_margin(pi_y, uncertainty) > ZERO_MARGIN_M
    return np.where(counts, np.sign(pi_y), 0.0) * uncertainty.half_widths


def gust_margin(
    uncertainty: UncertaintySet, vehicle: Vehicle, horizon: int, sampling_time_s: float
) -> Array:
    """Gust margin alpha_g,i = 1/2 (w_bar_g / m_min) (i T_s)^2, eq. (13).

    Returns
    -------
    NDArray, shape (N + 1,)
        [m].
    """
    min_mass_kg = (1.0 - uncertainty.mass) * vehicle.mass_kg
    time = sampling_time_s * np.arange(horizon + 1)
    return np.asarray(0.5 * uncertainty.gust_n / min_mass_kg * time**2, dtype=float)


def tightened_residual(tower: Tower, positions: Array, alpha: Array) -> Array:
    """Left side of eq. (14) in standard form, y(x_i) + alpha_i <= 0.

    Parameters
    ----------
    tower : Tower
        Radius and least clearance.
    positions : NDArray, shape (N + 1, 3)
        Planned positions, world frame [m].
    alpha : NDArray, shape (N + 1,)
        alpha_p + alpha_g [m].

    Returns
    -------
    NDArray, shape (N + 1,)
        [m], above zero where the tightened constraint is violated.
    """
    return tower.residual(positions) + alpha
