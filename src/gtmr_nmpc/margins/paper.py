# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The paper's margin: eq. (12) and (13). The compiled controller has it in C as well."""

import numpy as np
from numpy.typing import NDArray

from gtmr_model import UncertaintySet, Vehicle
from gtmr_nmpc.margins.margin import Iterate, Margin, Tightening
from gtmr_nmpc.sensitivity import clearance_sensitivity

Array = NDArray[np.float64]

ZERO_MARGIN_M = 1e-12
"""Terms of alpha_p below this are zero by symmetry, as in hover, and their sign is rounding's."""


class PaperMargin(Margin):
    """First-order worst case over the box of zeta, and double integration of the gust's bound."""

    def tightening(self, iterate: Iterate) -> Tightening:
        """alpha_p of eq. (12) and alpha_g of eq. (13)."""
        config, stages = iterate.config, len(iterate.x)
        pi_y = clearance_sensitivity(iterate.x, iterate.Pi, config.clearance_constraint)
        return Tightening(
            parametric_margin(pi_y, config.uncertainty),
            np.full(stages, config.eps_s_m),
            gust_margin(config.uncertainty, config.vehicle, stages - 1, config.sampling_time_s),
        )


def parametric_margin(pi_y: Array, uncertainty: UncertaintySet) -> Array:
    """Terms |Pi_y,i,j| w_bar_j of eq. (12) [m], without eps_s; both of shape (N + 1, 9)."""
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
    """alpha_g,i = 1/2 (w_bar_g / m_min) (i T_s)^2 of eq. (13) [m], shape (N + 1,)."""
    min_mass_kg = (1.0 - uncertainty.mass) * vehicle.mass_kg
    time = sampling_time_s * np.arange(horizon + 1)
    return np.asarray(0.5 * uncertainty.gust_n / min_mass_kg * time**2, dtype=float)
