# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Multi-stage NMPC: a tree of scenarios that branches once (Lucia et al., JPC 2013).

Every scenario has a force of its own along the whole horizon, and all share their first inputs.
The mean of their costs is minimised with the clearance and the rotor limits of each, one
Gauss-Newton QP a step as in our own controllers (`TreeQp`). With the scenario without force alone
it gives the nominal controller's inputs to 1e-9 Hz/s.

What it assumes: what happens is one of the scenarios, and after the branching it is known which.
Scenarios are those that matter to the clearance: no wind, and the corner of the wind's box that
pushes most towards the tower, or away from it, with a gust at its bound on top. Mass, thrust,
drag and inertia move the vehicle up and down or hardly at all, so they have no branch: with all
512 vertices one step would take seconds.

How tuned: by four factors of the paper's cost and by the stage at which the tree branches, for
each world, by a search of few flights. What it costs: 11 ms a step, half of it for linearising
and condensing three branches in NumPy, the rest for a QP of up to 348 variables; it therefore
flies fewer trials.

Where it breaks: branching after one stage, as n_robust = 1 of do-mpc does, plans as if the wind
were known 25 ms from now, so that the tree keeps hardly more distance than a nominal controller.
It never gets to know the wind, and a steady wind leaves a steady offset. What lies outside the
scenarios, noise and a wall, is not guarded against.

Its friends say that recourse makes it the least conservative family, and that branches may come
late. So the stage at which it branches is one of the numbers that are tuned, and five were found:
with eight common stages a flight at d_ref = 0.22 m comes 16 mm less close than with one. Its
state is filtered, and its QP is solved exactly.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gtmr_model.dynamics import POSITION
from gtmr_nmpc import ControllerConfig
from gtmr_nmpc.observer import BIAS, N_THETA
from gtmr_nmpc.reference.rti import Preparation, RealTimeIteration, Trajectory
from gtmr_study.rivals.robust_mpc.cost import CostParameters
from gtmr_study.rivals.robust_mpc.filtered import Filtered, near
from gtmr_study.rivals.robust_mpc.tree_qp import TreeQp
from gtmr_study.rivals.tuning import Tuned

Array = NDArray[np.float64]


class TreeParameters(CostParameters):
    """What the tree is tuned by: its cost, and when it branches."""

    common_stages: float = Field(8.0, ge=1.0, le=20.0)
    """Stages whose inputs all scenarios share, rounded; 1 is n_robust = 1 of do-mpc [-]."""


def winds(config: ControllerConfig, at: Array) -> Array:
    """Give the scenarios' forces at a position [N], world frame, shape (3, 3): none, in, out.

    The corner of the wind's box that pushes most towards the tower, with a gust at its bound on
    top, and the corner opposite.
    """
    outward = np.array([*at[:2], 0.0]) / np.hypot(at[0], at[1])
    box = config.uncertainty
    corner = np.sign(outward) * np.array(box.wind_bias_n)
    out = corner + box.gust_n * outward
    return np.stack([np.zeros(3), -out, out])


class ScenarioTree(Filtered):
    """One QP a step over all scenarios, by real-time iteration."""

    def __init__(
        self,
        config: ControllerConfig,
        parameters: TreeParameters,
        forces: Callable[[ControllerConfig, Array], Array] = winds,
    ) -> None:
        weighed = parameters.weigh(config)
        super().__init__(weighed)
        self._forces = forces
        self._common = min(round(parameters.common_stages), config.horizon)
        self._rti = RealTimeIteration(weighed)
        self._branches: list[Trajectory] = []
        self._now_s = np.nan

    def plan(self, now: float, x: Array) -> Array:
        """See `Filtered.plan`."""
        config = self.config
        x = near(config.helix.facing(now, config.tower), x)
        forces = self._forces(config, x[POSITION])
        iterates = self._moved_on(now, x, forces)
        prepared = []
        for force, iterate in zip(forces, iterates, strict=True):
            self._disturb(force)
            prepared.append(self._rti.prepare(now, iterate, "nominal"))
        qp = TreeQp([self._rti.condensed(p, x) for p in prepared], self._common * self._inputs)
        steps = qp.solve()
        self._branches = [_expanded(p, x, du) for p, du in zip(prepared, steps, strict=True)]
        self._now_s = now
        return self._branches[0].u[0]

    @property
    def _inputs(self) -> int:
        return self.config.vehicle.n_rotors

    def _disturb(self, force: Array) -> None:
        theta = np.zeros(N_THETA)
        theta[BIAS] = force
        self._rti.disturb(theta)

    def _moved_on(self, now: float, x: Array, forces: Array) -> list[Trajectory]:
        """Move the last branches on to now; past their ends the rotors hold their speeds."""
        n = self.config.horizon
        steps = (now - self._now_s) / self.config.sampling_time_s
        if not self._branches or not 0 <= round(steps) < n:
            hold = Trajectory(np.tile(x, (n + 1, 1)), np.zeros((n, self._inputs)))
            return [hold] * len(forces)
        moved: list[Trajectory] = []
        k = round(steps)
        for force, last in zip(forces, self._branches, strict=True):
            self._disturb(force)
            states, u = list(last.x[k:]), np.vstack([last.u[k:], np.zeros((k, self._inputs))])
            for stage in range(n - k, n):
                states.append(self._rti.predict(states[-1], u[stage], stage))
            # What is common is that of the first branch; the QP closes the gaps.
            if moved:
                u[: self._common] = moved[0].u[: self._common]
            moved.append(Trajectory(np.array(states), u))
        return moved


def _expanded(prep: Preparation, x: Array, du: Array) -> Trajectory:
    """Take the full step of one branch."""
    dx = prep.dx_du @ du + prep.dx_dx0 @ (x - prep.iterate.x[0]) + prep.defect
    return Trajectory(prep.iterate.x + dx, prep.iterate.u + du.reshape(prep.iterate.u.shape))


SCENARIO_TREE = Tuned("scenario_tree", TreeParameters, ScenarioTree, constrained=True)
"""Multi-stage NMPC."""
