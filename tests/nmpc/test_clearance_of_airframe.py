# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The constraint on the airframe: both iterations, its linearisation, its margins, its flights."""

from functools import cache

import numpy as np
import pytest

from gtmr_model import ConfigError, Vehicle, airframe_clearance
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.margins import paper as margins
from gtmr_nmpc.online.performance import standing
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_nmpc.reference.rti import RealTimeIteration, Trajectory
from gtmr_nmpc.sensitivity import clearance_sensitivity
from gtmr_sim import GustConfig, Scenario, fly

REAL_TOWER = ControllerConfig.load("controller", "real-tower")
TIGHT = REAL_TOWER.model_copy(
    update={"helix": REAL_TOWER.helix.model_copy(update={"offset_m": 0.76})}
)
"""A reference so close that the constraint is active."""


def scenario_of(config, **fields):
    world = {name: getattr(config, name) for name in ("vehicle", "tower", "helix", "uncertainty")}
    return Scenario(**world, **fields)


@cache
def plans(clearance_of="airframe"):
    """Robust plans of a flight that the constraint pushes outward, ten a second."""
    config = TIGHT.model_copy(update={"clearance_of": clearance_of})
    controller, kept = Controller(config), []

    class Recorder:
        def __init__(self):
            self.config = config

        def step(self, t, x):
            kept.append(controller.step(t, x))
            return kept[-1]

    fly(scenario_of(config, seed=4).sampled(), Recorder(), 3.0)
    return kept[4::4]


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("tightening", ["frozen", "gradient"])
@pytest.mark.parametrize(("vehicle", "offset_m"), [("paper", 0.76), ("quad", 0.62)])
def test_both_iterations_plan_the_same(vehicle, offset_m, tightening):
    config = TIGHT.model_copy(
        update={
            "vehicle": Vehicle.preset("vehicle", vehicle),
            "helix": TIGHT.helix.model_copy(update={"offset_m": offset_m}),
            "tightening": tightening,
        }
    )
    compiled = Controller(config, "robust", CompiledIteration(config))
    reference = Controller(config, "robust", InterpretedIteration(config))
    worst, tightest_m = 0.0, np.inf

    class Both:
        def __init__(self):
            self.config = config

        def step(self, t, x):
            nonlocal worst, tightest_m
            one, other = compiled.step(t, x), reference.step(t, x)
            for name in ("x_plan", "u_plan", "alpha_p", "alpha_p_by_channel", "alpha_g", "slack"):
                worst = max(worst, np.abs(getattr(one, name) - getattr(other, name)).max())
            tightest_m = min(tightest_m, standing(one, config)["tightest_to_spare_m"])
            return one

    fly(scenario_of(config, seed=1).sampled(), Both(), 0.75)
    assert worst < 1e-9
    assert tightest_m < 1e-6


def test_clearance_row_is_the_derivative_of_the_clearance_with_the_attitude_held():
    rti, rng = RealTimeIteration(TIGHT), np.random.default_rng(0)
    for plan in plans()[:3]:
        # A plan that the model follows: the row is then the total derivative of the rollout.
        states = [plan.x_plan[0]]
        for u in plan.u_plan:
            states.append(rti.predict(states[-1], u))
        prep = rti.prepare(0.0, Trajectory(np.array(states), plan.u_plan), "nominal")
        direction, step = rng.standard_normal(plan.u_plan.shape), 1e-3

        def residual(u_plan, states=tuple(states)):
            x = [states[0]]
            for u in u_plan:
                x.append(rti.predict(x[-1], u))
            held = np.hstack([np.array(x)[:, :3], np.array(states)[:, 3:6]])
            return TIGHT.clearance_constraint.residual(held[1:], TIGHT.tower)

        difference = residual(plan.u_plan + step * direction)
        difference -= residual(plan.u_plan - step * direction)
        along = prep.clearance_rows @ direction.ravel()
        np.testing.assert_allclose(along, difference / (2 * step), rtol=1e-5, atol=1e-10)


def test_margin_gradient_is_the_derivative_of_alpha_p():
    config = TIGHT.model_copy(update={"tightening": "gradient"})
    rti, rng = RealTimeIteration(config), np.random.default_rng(0)

    def alpha_p(x, u):
        pi_y = clearance_sensitivity(
            x, rti.sensitivities(Trajectory(x, u)), config.clearance_constraint
        )
        return margins.parametric_margin(pi_y, config.uncertainty).sum(axis=1)

    scale = np.r_[[0.1] * 3, [0.1] * 3, [0.3] * 3, [0.3] * 3, [5.0] * 6]
    for plan in plans()[:3]:
        x, u = plan.x_plan, plan.u_plan
        d_x, d_u = rti.margin_gradient(Trajectory(x, u))
        dx, du = rng.standard_normal(x.shape) * scale, rng.standard_normal(u.shape)
        step = 1e-5
        difference = alpha_p(x + step * dx, u + step * du)
        difference = (difference - alpha_p(x - step * dx, u - step * du)) / (2 * step)
        predicted = np.einsum("ikx,kx->i", d_x, dx) + np.einsum("iku,ku->i", d_u, du)
        np.testing.assert_allclose(predicted, difference, rtol=1e-4, atol=1e-7)


def test_margins_count_how_the_attitude_moves_the_discs():
    rti = RealTimeIteration(TIGHT)
    plan = plans()[0]
    pi = rti.sensitivities(Trajectory(plan.x_plan, plan.u_plan))
    step = 1e-6
    for j in range(9):
        moved = [plan.x_plan.copy(), plan.x_plan.copy()]
        moved[0] += step * pi[:, :, j]
        moved[1] -= step * pi[:, :, j]
        y = [TIGHT.clearance_constraint.residual(x, TIGHT.tower) for x in moved]
        term = np.abs(y[0] - y[1]) / (2 * step) * TIGHT.uncertainty.half_widths[j]
        np.testing.assert_allclose(plan_terms(plan, pi)[:, j], term, rtol=1e-5, atol=1e-8)


def plan_terms(plan, pi):
    pi_y = clearance_sensitivity(plan.x_plan, pi, TIGHT.clearance_constraint)
    return margins.parametric_margin(pi_y, TIGHT.uncertainty)


@pytest.mark.parametrize("mode", ["robust", "offset_free"])
@pytest.mark.parametrize("gust", ["ou", "worst-case"])
def test_at_a_real_tower_no_part_of_the_airframe_comes_closer_than_d_min(mode, gust):
    scenario = scenario_of(REAL_TOWER, gust=GustConfig(kind=gust), seed=2).sampled()
    log = fly(scenario, Controller(REAL_TOWER, mode), 10.0)
    clearance = airframe_clearance(log.x, REAL_TOWER.vehicle, REAL_TOWER.tower)
    assert clearance.min() > REAL_TOWER.tower.min_clearance_m
    assert not log.failed.any()


def test_a_wind_that_pushes_on_and_on_does_not_make_the_vehicle_tip_over():
    scenario = scenario_of(REAL_TOWER, gust=GustConfig(kind="worst-case"), seed=2).sampled()
    log = fly(scenario, Controller(REAL_TOWER, "nominal"), 10.0)
    assert np.abs(log.x[:, 3:5]).max() < 0.1
    assert log.max_slack_m < 0.01


def test_at_a_real_tower_the_airframe_flies_at_d_ref():
    scenario = scenario_of(REAL_TOWER, gust=GustConfig(kind="none"))
    log = fly(scenario, Controller(REAL_TOWER, "offset_free"), 8.0)
    clearance = airframe_clearance(log.x, REAL_TOWER.vehicle, REAL_TOWER.tower)
    np.testing.assert_allclose(clearance[120:], 0.35, atol=2e-3)


def test_constraint_on_the_airframe_keeps_discs_out_where_that_on_the_centre_does_not():
    least = {}
    for clearance_of in ("centre", "airframe"):
        config = TIGHT.model_copy(update={"clearance_of": clearance_of})
        log = fly(scenario_of(config, seed=4).sampled(), Controller(config), 6.0)
        least[clearance_of] = airframe_clearance(log.x, config.vehicle, config.tower).min()
    assert least["centre"] < TIGHT.tower.min_clearance_m < least["airframe"]


def test_what_the_constraint_is_on_cannot_change_in_flight():
    with pytest.raises(ValueError, match="clearance_of cannot change in flight"):
        Controller(REAL_TOWER).reconfigure(
            REAL_TOWER.model_copy(update={"clearance_of": "centre"})
        )


def test_a_margin_of_the_centre_alone_is_refused():
    with pytest.raises(ConfigError, match="clearance_of = 'airframe': margin = 'second-order'"):
        ControllerConfig.parse({"margin": "second-order", "clearance_of": "airframe"}, "here")
    with pytest.raises(ConfigError, match=r"clearance_of = 'rotor'.*'centre' or 'airframe'"):
        ControllerConfig.parse({"clearance_of": "rotor"}, "here")
