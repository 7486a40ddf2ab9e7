# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.
"""References of one's own: chosen by name in YAML, flown by the compiled and other iteration."""

import math

import casadi as ca
import numpy as np
import pytest
import yaml

from gtmr_model import ConfigError, Helix, ReferencePath, Tower
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.compiled.codegen import c_sources
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.reference.eigenmodes import closed_loop_modes
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_sim import Scenario, fly
from gtmr_study.campaign.study import Study
from gtmr_study.campaign.trial import FLOWN, fly_trial


class Scan(ReferencePath):
    """Up and down in front of the tower, so many times a period, at constant clearance."""

    kind: str = "scan"
    beyond_min_m: float = 0.2
    amplitude_m: float = 0.3
    period_s: float = 4.0
    strokes: int = 1
    axis: tuple[float, float] = (1.0, 0.0)

    def position(self, t, tower):
        reach = tower.radius_m + tower.min_clearance_m + self.beyond_min_m
        height = 2.0 + self.amplitude_m * ca.sin(2.0 * math.pi * self.strokes * t / self.period_s)
        return ca.vertcat(reach * self.axis[0], reach * self.axis[1], height)

    def yaw(self, t, tower):
        return math.atan2(-self.axis[1], -self.axis[0])


TEXT = """
helix: {kind: scan, period_s: 3.0, strokes: 2, axis: [0.0, 1.0]}
"""
CONFIG = ControllerConfig.parse(yaml.safe_load(TEXT), "text")
SCENARIO = Scenario.parse({**yaml.safe_load(TEXT), "seed": 3}, "text").sampled()


def test_a_reference_of_ones_own_is_chosen_by_its_name_and_numbers():
    assert CONFIG.helix == SCENARIO.helix == Scan(period_s=3.0, strokes=2, axis=(0.0, 1.0))
    assert ControllerConfig.parse(CONFIG.model_dump(mode="json"), "again") == CONFIG


def test_its_derivatives_are_those_of_its_formula():
    t = np.linspace(0.0, 3.0, 50)
    rate = 2.0 * math.pi * 2 / 3.0
    at = CONFIG.helix.at(t, CONFIG.tower)
    np.testing.assert_allclose(at.position[:, 1], 1.4, atol=1e-12)
    np.testing.assert_allclose(at.velocity[:, 2], 0.3 * rate * np.cos(rate * t), atol=1e-12)
    np.testing.assert_allclose(at.acceleration[:, 2], -0.3 * rate**2 * np.sin(rate * t), atol=1e-9)
    np.testing.assert_allclose(at.yaw, -math.pi / 2, atol=1e-15)
    np.testing.assert_array_equal(at.yaw_rate, 0.0)
    np.testing.assert_allclose(CONFIG.helix.clearance(t, CONFIG.tower), 0.4, atol=1e-12)


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("mode", ["nominal", "robust"])
def test_both_iterations_plan_the_same_along_it(mode):
    compiled = Controller(CONFIG, mode, CompiledIteration(CONFIG))
    interpreted = Controller(CONFIG, mode, InterpretedIteration(CONFIG))
    x = CONFIG.helix.initial_state(CONFIG.tower, CONFIG.vehicle)
    for k in range(8):
        one, other = compiled.step(0.025 * k, x), interpreted.step(0.025 * k, x)
        assert one.status == other.status
        np.testing.assert_allclose(one.u_plan, other.u_plan, atol=1e-6)
        np.testing.assert_allclose(one.x_plan, other.x_plan, atol=1e-8)
        x = one.x_plan[1]


@pytest.mark.usefixtures("unoptimised")
def test_it_is_flown():
    log = fly(SCENARIO, Controller(CONFIG, "nominal", CompiledIteration(CONFIG)), 3.0)
    reference = SCENARIO.helix.at(log.t, SCENARIO.tower)
    assert np.abs(log.x[:, :3] - reference.position).max() < 0.2
    assert np.ptp(log.x[:, 2]) > 0.4
    assert log.d_T.min() > SCENARIO.tower.min_clearance_m


@pytest.mark.slow
def test_only_fields_that_are_no_numbers_compile_anew():
    def sources(**fields):
        return c_sources(ControllerConfig(helix=Scan(**fields)))

    assert sources() == sources(amplitude_m=0.1, beyond_min_m=0.5)
    assert sources() != sources(strokes=2)
    assert sources() != sources(axis=(0.0, 1.0))
    helix = c_sources(ControllerConfig())
    assert helix == c_sources(ControllerConfig(helix=Helix(speed_m_s=-1.0, offset_m=0.5)))


def test_a_campaign_measures_from_its_own_clearance():
    row = fly_trial(Study(controller=CONFIG, duration_s=1.0), 0, "nominal")
    assert row["status"] == FLOWN
    assert 0.0 < row["radial_rms_m"] < 0.1


def test_reports_tell_its_clearance():
    class Inwards(Scan):
        kind: str = "inwards"

        def position(self, t, tower):
            return ca.vertcat(tower.radius_m + 0.6 - 0.1 * t, 0.0, 2.0)

    assert Helix().clearance_text(60.0, Tower()) == "0.35 m"
    assert Inwards().clearance_text(2.0, Tower()) == "0.4 to 0.6 m"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"kind": "spiral"}, r"helix = .*kind = 'spiral': there is helix, .*scan"),
        ({"kind": "scan", "offset_m": 0.4}, r"helix\.offset_m is not a known field$"),
        ({"kind": "helix", "strokes": 2}, r"helix\.strokes is not a known field$"),
    ],
)
@pytest.mark.parametrize("model", [ControllerConfig, Scenario])
def test_a_reference_that_does_not_exist_is_refused_in_one_line(model, given, said):
    with pytest.raises(ConfigError, match=said) as raised:
        model.parse({"helix": given}, "here")
    assert "\n" not in str(raised.value)


def test_what_needs_a_helix_refuses_another_reference():
    with pytest.raises(ConfigError, match=r"^helix\.kind = 'scan': for this it must be 'helix'$"):
        closed_loop_modes(CONFIG)


def test_a_controller_made_for_another_reference_is_refused():
    with pytest.raises(ConfigError, match=r"helix = .*: the controller is made for"):
        fly(SCENARIO, Controller(ControllerConfig(), "nominal"), 0.1)
