# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Zero-order robust optimisation with ellipsoids, zoRO, as a margin on our own iteration.

A matrix P is carried along the plan, P_{i+1} = A P A' + G W G', and the clearance of stage i is
tightened by sqrt(c' P_i c), c its gradient (Zanelli, Frey, Messerer, Diehl, NMPC 2021). P is held
while a QP is solved, which makes the order zero. With feedback A + B K takes the place of A, K
being the LQR of the QP's own weights.

What it assumes: deviations are linear, mismatch is small, the state is known exactly. zeta is
constant in time, so the state is augmented with it: its ellipsoid E enters at stage 0 and zeta
moves the state at every step, which a W of independent steps would get wrong. Gusts are
independent. One joint ellipsoid holds the whole box of zeta and the balls of all gusts, corners
included, so that what flies is a guarantee of the linear model and no quantile; of all ellipsoids
with axes along them it is the one with the smallest spread across at the end of the horizon.
Before stage 0 there is what may happen while odometry is late. Rotor limits are not tightened: a
margin speaks of the clearance alone.

How tuned: by four factors of the paper's cost, for each world. What it costs: 0.5 ms a step, 0.6
ms with feedback, nearly all of it products of matrices along the plan in NumPy.

Where it breaks: it knows nothing of measurement noise, nor of what a wall adds to the bounds. A
steady wind leaves a steady offset, since nothing is learnt. Without feedback it bounds a vehicle
that nobody steers; with feedback it trusts that K acts where the QP acts, which a rotor at its
limit does not.

Its friends say that an ellipsoid is the cheapest set that knows correlations, that shape matrices
need no vertices, and that feedback in the tube makes it small. So it gets a filtered state, it
has feedback as a rival of its own, and axes chosen anew at every step: with axes chosen once at
hover a plan that tilts gets margins that drive the next plan to tilt more, and it flies away.
"""

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gtmr_model import N_ZETA
from gtmr_model.dynamics import YAW
from gtmr_nmpc import Controller, ControllerConfig, Iterate
from gtmr_study.rivals.robust_mpc.ancillary import Ancillary
from gtmr_study.rivals.robust_mpc.cost import CostParameters
from gtmr_study.rivals.robust_mpc.filtered import Filtered
from gtmr_study.rivals.robust_mpc.linearised import linearise
from gtmr_study.rivals.tuning import Tuned

Array = NDArray[np.float64]

LEAST_MOVE = 0.01
"""What a disturbance counts at least, where shares are given, of the one that moves most [-]."""


class EllipsoidMargin:
    """sqrt(c' P c) with P carried along the plan: a margin for `Controller`."""

    def __init__(self, config: ControllerConfig, feedback: bool) -> None:
        self._late = math.ceil(config.delay_s / config.sampling_time_s - 1e-9)
        self._ancillary = Ancillary(config) if feedback else None

    def tightening(self, iterate: Iterate) -> Array:
        """Half-widths of the clearance at stages 0..N [m], shape (N + 1,)."""
        config = iterate.config
        normals = config.clearance_constraint.gradient(iterate.x)
        moved = self.generators(iterate)[:, : normals.shape[1]]
        across = np.einsum("ij,ijk->ik", normals, moved)
        half_widths = np.sqrt((across**2 / shares(moved[-1])).sum(axis=1))
        return np.asarray(config.eps_s_m + half_widths)

    def generators(self, iterate: Iterate) -> Array:
        """Say what each disturbance at its bound does to states, shape (N + 1, n_x, columns).

        The columns are zeta's nine, then three of each gust, those during the delay first.
        """
        config, (stages, n_x) = iterate.config, iterate.x.shape
        a, b, e, g = linearise(config.vehicle, config.sampling_time_s, iterate.x[:-1], iterate.u)
        e = e * config.uncertainty.half_widths
        g = g * config.uncertainty.gust_n
        closed = a
        if self._ancillary is not None:
            closed = a + b @ np.array([self._ancillary.gain(yaw) for yaw in iterate.x[:-1, YAW]])
        late = self._late
        moved = np.zeros((stages, n_x, N_ZETA + 3 * (late + stages - 1)))
        at = np.zeros(moved.shape[1:])
        for step in range(late + stages - 1):
            i, gust = max(0, step - late), N_ZETA + 3 * step
            # Columns of later gusts are still zero.
            at[:, :gust] = (closed if step >= late else a)[i] @ at[:, :gust]
            at[:, :N_ZETA] += e[i]
            at[:, gust : gust + 3] += g[i]
            if step >= late - 1:
                moved[step - late + 1] = at
        return moved


def shares(moved: Array) -> Array:
    """Share of the joint ellipsoid that each column of generators gets, shape (columns,).

    sum_j zeta_j^2 / E_j + sum_i |w_i|^2 / W_i <= 1 holds the box of zeta and the balls of all
    gusts if E_j = w_bar_j^2 / share_j and W_i = w_bar_g^2 / share_i, and the shares of channels
    and steps sum to 1. In proportion to how far each alone moves the vehicle across by the end of
    the horizon they make P_N smallest in its trace over x and y.
    """
    squared = (moved[:2] ** 2).sum(axis=0)
    gusts = np.sqrt(squared[N_ZETA:].reshape(-1, 3).sum(axis=1))
    reach = np.concatenate([np.sqrt(squared[:N_ZETA]), gusts])
    reach += LEAST_MOVE * reach.max()
    share = reach / reach.sum()
    return np.concatenate([share[:N_ZETA], np.repeat(share[N_ZETA:], 3)])


class Ellipsoid(Filtered):
    """Plans with ellipsoids from a filtered state."""

    def __init__(
        self, config: ControllerConfig, parameters: CostParameters, feedback: bool
    ) -> None:
        weighed = parameters.weigh(config)
        super().__init__(weighed)
        # A margin of one's own is any object with ``tightening``.
        margin: Any = EllipsoidMargin(weighed, feedback)
        self._planner = Controller(weighed, "robust", margin=margin)

    def plan(self, now: float, x: Array) -> Array:
        """See `Filtered.plan`."""
        return self._planner.step(now, x).u


ELLIPSOID = Tuned(
    "ellipsoid", CostParameters, partial(Ellipsoid, feedback=False), constrained=True
)
"""zoRO without feedback in its tube."""
ELLIPSOID_FEEDBACK = Tuned(
    "ellipsoid_feedback", CostParameters, partial(Ellipsoid, feedback=True), constrained=True
)
"""zoRO with feedback in its tube."""
