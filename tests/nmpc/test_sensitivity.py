# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Pi and the margin gradient against finite differences, along a real flight."""

from functools import cache

import numpy as np
import pytest

from gtmr_model import UncertaintySet
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.margins import paper as margins
from gtmr_nmpc.ocp import discrete_dynamics
from gtmr_nmpc.reference.rti import RealTimeIteration, Trajectory
from gtmr_nmpc.sensitivity import clearance_sensitivity
from gtmr_sim import Scenario, fly


@pytest.fixture(scope="module")
def plans():
    """Robust plans of a flight under mismatch and gusts, one a second."""
    controller, kept = Controller(), []

    class Recorder:
        def step(self, t, x):
            solution = controller.step(t, x)
            kept.append(solution)
            return solution

    fly(Scenario(seed=4).sampled(), Recorder(), 6.0)
    return kept[10::40]


@cache
def horizon_dynamics(config):
    """Step after step of the discrete model, in one call."""
    return discrete_dynamics(config).mapaccum(config.horizon)


def perturbed_states(config, x0, u_plan, zeta):
    """Roll out the discrete model from x0 with the planned inputs and another zeta."""
    later = horizon_dynamics(config)(x0, u_plan.T, np.tile(zeta[:, None], len(u_plan)))
    return np.vstack([x0, np.asarray(later).T])


def test_pi_is_the_derivative_of_the_discrete_model_in_every_entry(plans):
    config = ControllerConfig()
    rti = RealTimeIteration(config)
    for plan in plans:
        rollout = perturbed_states(config, plan.x_plan[0], plan.u_plan, np.zeros(9))
        pi = rti.sensitivities(Trajectory(rollout, plan.u_plan))
        assert pi.shape == (21, 18, 9)
        for j in range(9):
            # Richardson extrapolation of two central differences: truncation below rounding.
            differences = []
            for step in (1e-3, 2e-3):
                zeta = np.zeros(9)
                zeta[j] = step
                plus = perturbed_states(config, plan.x_plan[0], plan.u_plan, zeta)
                minus = perturbed_states(config, plan.x_plan[0], plan.u_plan, -zeta)
                differences.append((plus - minus) / (2 * step))
            derivative = (4 * differences[0] - differences[1]) / 3
            # Entries that vanish are held to the rounding of a state over the step.
            np.testing.assert_allclose(pi[:, :, j], derivative, rtol=1e-6, atol=2e-11)


def test_margin_gradient_is_the_derivative_of_alpha_p(plans):
    config = ControllerConfig(tightening="gradient")
    rti = RealTimeIteration(config)
    rng = np.random.default_rng(0)

    def alpha_p(x, u):
        pi = rti.sensitivities(Trajectory(x, u))
        pi_y = clearance_sensitivity(x[:, :3], pi)
        return margins.parametric_margin(pi_y, config.uncertainty).sum(axis=1)

    for plan in plans[:3]:
        x, u = plan.x_plan, plan.u_plan
        d_x, d_u = rti.margin_gradient(Trajectory(x, u))
        for _ in range(5):
            scale = np.r_[[0.1] * 3, [0.1] * 3, [0.3] * 3, [0.3] * 3, [5.0] * 6]
            dx, du = rng.standard_normal(x.shape) * scale, rng.standard_normal(u.shape)
            step = 1e-4
            difference = alpha_p(x + step * dx, u + step * du)
            difference = (difference - alpha_p(x - step * dx, u - step * du)) / (2 * step)
            predicted = np.einsum("ikx,kx->i", d_x, dx) + np.einsum("iku,ku->i", d_u, du)
            np.testing.assert_allclose(predicted, difference, rtol=1e-5, atol=1e-8)


def test_alpha_p_is_the_worst_vertex(plans):
    box = UncertaintySet()
    rti = RealTimeIteration(ControllerConfig())
    for plan in plans:
        pi = rti.sensitivities(Trajectory(plan.x_plan, plan.u_plan))
        outward = plan.x_plan[:, :3] * [1, 1, 0]
        gradient = -outward / np.linalg.norm(outward, axis=1, keepdims=True)
        pi_y = np.einsum("ik,ikj->ij", gradient, pi[:, :3])
        worst = np.abs(pi_y @ box.vertices().T).max(axis=1)
        by_channel = margins.parametric_margin(clearance_sensitivity(plan.x_plan[:, :3], pi), box)
        np.testing.assert_allclose(by_channel.sum(axis=1), worst, rtol=0, atol=1e-12)


def test_alpha_p_of_the_step_is_its_channels_plus_eps_s(plans):
    for plan in plans:
        assert (plan.eps_s == ControllerConfig().eps_s_m).all()
        total = plan.alpha_p_by_channel.sum(axis=1) + plan.eps_s
        np.testing.assert_allclose(plan.alpha_p, total, rtol=0, atol=1e-15)
        assert plan.alpha_p[0] == plan.eps_s[0]
        assert (np.diff(plan.alpha_p) >= 0).all()


def test_alpha_g_is_double_integration_of_the_bound():
    step = Controller().step(
        0.0, Scenario().helix.initial_state(Scenario().tower, Scenario().vehicle)
    )
    time = 0.025 * np.arange(21)
    np.testing.assert_allclose(step.alpha_g, 0.5 * 0.6 / (0.9 * 2.57) * time**2, rtol=1e-14)
    assert step.alpha_g[-1] == pytest.approx(0.0324, abs=5e-5)


def test_nominal_mode_has_no_margins():
    scenario = Scenario()
    x = scenario.helix.initial_state(scenario.tower, scenario.vehicle)
    step = Controller(mode="nominal").step(0.0, x)
    for margin in (step.alpha_p, step.alpha_p_by_channel, step.alpha_g, step.eps_s):
        assert np.all(margin == 0.0)
