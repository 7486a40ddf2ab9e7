# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.
"""Margins as objects: the paper's, a fixed one, and one's own; compiled and interpreted."""

import numpy as np
import pytest

from gtmr_model import ConfigError
from gtmr_nmpc import Controller, ControllerConfig, Margin, Tightening
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.margins import FixedMargin, PaperMargin
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_sim import Scenario, fly
from gtmr_study.export.project import export_c

SCENARIO = Scenario(seed=3).sampled()
CONFIG = ControllerConfig()
FIXED = ControllerConfig.parse({"margin": {"kind": "fixed", "margin_m": 0.01}}, "here")


class GrowsWithSpeed(Margin):
    """A margin of one's own: so many seconds of the planned speed, known by a name."""

    kind: str = "grows-with-speed"
    seconds_s: float = 0.1

    def tightening(self, iterate):
        return self.seconds_s * np.linalg.norm(iterate.x[:, 6:9], axis=1)


class NearAndFar:
    """Another, which is no model of a configuration, and uses what a margin is told."""

    def tightening(self, iterate):
        assert iterate.u.shape == (20, 6)
        assert iterate.Pi.shape == (21, 18, 9)
        stages = np.arange(21.0)
        return Tightening(1e-3 * np.abs(iterate.Pi[:, 0]), np.full(21, 0.02), 1e-3 * stages)


def steps(controller, count=6):
    """Plans along the start of one flight, which the margins of the controller do not change."""
    state = SCENARIO.helix.initial_state(SCENARIO.tower, SCENARIO.vehicle)
    plans = []
    for k in range(count):
        plans.append(controller.step(0.025 * k, state))
        state = plans[-1].x_plan[1]
    return plans


@pytest.mark.parametrize("iteration", [CompiledIteration, InterpretedIteration])
def test_the_papers_margin_as_an_object_is_the_one_of_the_iteration(iteration):
    inside = steps(Controller(CONFIG, iteration=iteration(CONFIG)))
    outside = steps(Controller(CONFIG, iteration=iteration(CONFIG), margin=PaperMargin()))
    assert outside[-1].alpha_p[-1] > 0.05
    for own, given in zip(inside, outside, strict=True):
        for name in ("alpha_p", "alpha_p_by_channel", "alpha_g", "eps_s"):
            np.testing.assert_allclose(getattr(given, name), getattr(own, name), atol=1e-14)
        np.testing.assert_allclose(given.u_plan, own.u_plan, atol=1e-7)
        np.testing.assert_allclose(given.slack, own.slack, atol=1e-12)


@pytest.mark.parametrize("margin", [FixedMargin(margin_m=0.2), GrowsWithSpeed(), NearAndFar()])
def test_both_iterations_plan_the_same_with_any_margin(margin):
    compiled = steps(Controller(CONFIG, iteration=CompiledIteration(CONFIG), margin=margin))
    interpreted = steps(Controller(CONFIG, iteration=InterpretedIteration(CONFIG), margin=margin))
    for one, other in zip(compiled, interpreted, strict=True):
        assert one.status == other.status
        np.testing.assert_allclose(one.u_plan, other.u_plan, atol=1e-6)
        np.testing.assert_allclose(one.alpha_p, other.alpha_p, atol=1e-12)
        np.testing.assert_allclose(one.slack, other.slack, atol=1e-9)


def test_a_fixed_margin_of_10_mm_flies_and_is_said_at_every_stage():
    log = fly(SCENARIO, Controller(FIXED), 1.0)
    np.testing.assert_array_equal(log.alpha_p, 0.01)
    np.testing.assert_array_equal(log.alpha_g, 0.0)
    assert log.d_T.min() > SCENARIO.tower.min_clearance_m


def test_a_fixed_margin_of_nothing_is_the_nominal_controller():
    nothing = fly(SCENARIO, Controller(CONFIG, margin=FixedMargin(margin_m=0.0)), 1.0)
    nominal = fly(SCENARIO, Controller(CONFIG, "nominal"), 1.0)
    np.testing.assert_array_equal(nothing.x, nominal.x)


def test_a_margin_keeps_the_plan_so_much_further_away():
    (plan,) = steps(Controller(CONFIG, margin=FixedMargin(margin_m=0.3)), 1)
    clearance = SCENARIO.tower.clearance(plan.x_plan) + plan.slack
    assert (clearance[1:] >= 0.5 - 1e-6).all()
    assert plan.slack[0] == pytest.approx(0.5 - SCENARIO.helix.offset_m)


def test_nominal_mode_has_no_margin_whatever_was_chosen():
    (plan,) = steps(Controller(FIXED, "nominal"), 1)
    assert (plan.tightening.total == 0.0).all()


def test_a_switch_brings_any_margin_in_gently():
    controller = Controller(FIXED, "nominal")
    steps(controller, 2)
    controller.mode = "robust"
    x = SCENARIO.helix.initial_state(SCENARIO.tower, SCENARIO.vehicle)
    partly = controller.step(0.5, x)
    assert 0.0 < partly.margin_scale < 1.0
    np.testing.assert_allclose(partly.alpha_p, 0.01 * partly.margin_scale)


def test_a_margin_of_ones_own_is_chosen_by_its_name_and_numbers():
    data = {"margin": {"kind": "grows-with-speed", "seconds_s": 0.2}}
    config = ControllerConfig.parse(data, "here")
    assert config.margin == GrowsWithSpeed(seconds_s=0.2)
    assert ControllerConfig.parse(config.model_dump(mode="json"), "again") == config
    assert ControllerConfig.parse({"margin": "fixed"}, "here").margin == FixedMargin()


@pytest.mark.parametrize(
    ("margin", "said"),
    [
        ({"kind": "wide"}, r"margin = .*kind = 'wide': there is closed-loop, fixed, .*paper.*$"),
        ("wide", r"margin = 'wide': kind = 'wide': there is closed-loop, fixed, .*paper.*$"),
        (
            {"kind": "fixed", "margin_m": -1.0},
            r"margin\.margin_m = -1\.0: .*greater than or equal",
        ),
        ({"kind": "paper", "margin_m": 1.0}, r"margin\.margin_m is not a known field$"),
        (3, r"margin = 3: Input should be a valid dictionary"),
    ],
)
def test_a_margin_that_does_not_exist_is_refused_in_one_line(margin, said):
    with pytest.raises(ConfigError, match=said) as raised:
        ControllerConfig.parse({"margin": margin}, "here")
    assert "\n" not in str(raised.value)


def test_only_the_papers_margin_enters_with_its_gradient():
    with pytest.raises(ConfigError, match=r"tightening = 'gradient': margin = 'fixed' has none"):
        ControllerConfig.parse({"margin": "fixed", "tightening": "gradient"}, "here")
    with pytest.raises(ValueError, match=r"tightening = 'gradient': a margin of one's own"):
        Controller(ControllerConfig(tightening="gradient"), margin=NearAndFar())


@pytest.mark.parametrize("given", [np.zeros(20), np.full(21, np.nan), 0.1])
def test_a_margin_that_gives_no_tightening_of_every_stage_is_named(given):
    class Broken:
        def tightening(self, _):
            return given

    with pytest.raises(ValueError, match="Broken gave a tightening that is not 21 finite numbers"):
        steps(Controller(CONFIG, margin=Broken()), 1)


def test_c_for_other_machines_is_not_written_for_a_margin_that_it_has_not(tmp_path):
    with pytest.raises(ConfigError, match="margin = 'fixed': in C there is the paper's alone"):
        export_c(FIXED, "robust", tmp_path / "c")
    assert not (tmp_path / "c").exists()
