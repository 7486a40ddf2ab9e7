# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import numpy as np
import pytest

from gtmr_nmpc import Controller, ControllerConfig, ocp
from gtmr_nmpc.margins import Iterate, PaperMargin, SecondOrderMargin
from gtmr_nmpc.margins.second_order import second_order_clearance
from gtmr_nmpc.reference.rti import RealTimeIteration, Trajectory

CONFIG = ControllerConfig()
NOMINAL = np.zeros(9)


@pytest.fixture(scope="module", params=[0, 1])
def plan(request):
    """A plan whose states are those of its inputs: from rest, and tilted towards the tower."""
    controller = Controller(CONFIG, "robust")
    x = CONFIG.helix.initial_state(CONFIG.tower, CONFIG.vehicle)
    if request.param:
        x[:12] += [-0.05, 0.02, 0.0, 0.1, -0.2, 0.1, -0.3, 0.1, 0.2, 0.3, 0.2, -0.2]
    u = controller.step(0.0, x).u_plan
    states = rollout(x, u, NOMINAL[:, None])[:, :, 0]
    rti = RealTimeIteration(CONFIG)
    return Iterate(CONFIG, states, u, lambda: rti.sensitivities(Trajectory(states, u)))


def rollout(x, u, zetas):
    """States under each column of zetas, shape (N + 1, n_x, columns)."""
    columns = zetas.shape[1]
    step = ocp.discrete_dynamics(CONFIG).map(columns)
    states = [np.tile(x[:, None], columns)]
    for inputs in u:
        states.append(np.asarray(step(states[-1], np.tile(inputs[:, None], columns), zetas)))
    return np.array(states)


def clearances(iterate, zetas):
    """d_T at every stage under each column of zetas, shape (N + 1, columns)."""
    states = rollout(iterate.x[0], iterate.u, zetas)
    return np.hypot(states[:, 0], states[:, 1]) - CONFIG.tower.radius_m


def test_no_vertex_exceeds_the_second_order_margin_as_some_do_the_papers(plan):
    vertices = CONFIG.uncertainty.vertices().T
    closer = clearances(plan, NOMINAL[:, None]) - clearances(plan, vertices)

    def exceed(margin):
        alpha = margin.tightening(plan).by_channel.sum(axis=1)[:, None]
        return int((closer[1:] > alpha[1:] * (1.0 + 1e-9)).any(axis=0).sum())

    assert exceed(SecondOrderMargin()) == 0
    if plan.x[0, 3] == 0.0:
        assert exceed(PaperMargin()) > 0
        # It is no wider than it must be.
        alpha = SecondOrderMargin().tightening(plan).by_channel.sum(axis=1)
        assert closer[-1].max() > 0.95 * alpha[-1]


def test_second_derivatives_are_those_of_differences(plan):
    exact = second_order_clearance(plan)[-1]
    step, unit = 1e-3, np.eye(9)
    for j, k in ((0, 0), (0, 4), (4, 4), (0, 6), (4, 7), (1, 2), (5, 6)):
        signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
        zetas = np.array([step * (a * unit[j] + b * unit[k]) for a, b in signs]).T
        weights = np.array([a * b for a, b in signs])
        differences = -(clearances(plan, zetas)[-1] @ weights) / (4.0 * step * step)
        assert exact[j, k] == pytest.approx(differences, rel=1e-3, abs=1e-6)


def test_the_robust_mode_flies_with_it():
    config = ControllerConfig(margin={"kind": "second-order"})
    x = CONFIG.helix.initial_state(CONFIG.tower, CONFIG.vehicle)
    wide, paper = (Controller(c, "robust").step(0.0, x) for c in (config, CONFIG))
    assert 1.05 * paper.alpha_p[-1] < wide.alpha_p[-1] < 1.2 * paper.alpha_p[-1]
