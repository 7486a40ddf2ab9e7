# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the controller says of itself adds up."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gtmr_model import CHANNELS, Tower
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.online.performance import Performance, quantiles, standing
from gtmr_nmpc.solution import Timing
from gtmr_sim import Scenario

SCENARIO = Scenario()
START = SCENARIO.helix.initial_state(SCENARIO.tower, SCENARIO.vehicle)


def near_the_tower(clearance_m, mode="robust"):
    x = START.copy()
    x[0] = SCENARIO.tower.radius_m + clearance_m
    solution = Controller(mode=mode).step(0.0, x)
    return solution, standing(solution, ControllerConfig())


def test_the_margins_of_the_tightest_stage_add_up():
    solution, said = near_the_tower(0.28)
    stage = said["tightest_stage"]
    channels = sum(said[f"tightest_margin_{channel}_m"] for channel in CHANNELS)
    total = channels + solution.eps_s[0] + said["tightest_margin_gust_m"]
    assert said["tightest_margin_m"] == pytest.approx(total)
    distance = Tower().clearance(solution.x_plan)[stage]
    assert said["tightest_to_spare_m"] == pytest.approx(distance - 0.2 - total)
    alpha = solution.alpha_p + solution.alpha_g
    assert stage == np.argmin(Tower().clearance(solution.x_plan) - alpha)


def test_a_plan_far_from_the_tower_has_nothing_active():
    _, said = near_the_tower(0.6, "nominal")
    assert said["active_clearance_stages"] == 0
    assert said["slack_m"] == said["tightest_margin_m"] == said["margin_scale"] == 0.0


def test_a_plan_that_starts_too_close_is_active_and_uses_slack():
    solution, said = near_the_tower(0.15)
    assert said["slack_m"] == pytest.approx(solution.slack.max())
    assert said["slack_m"] > 0.05
    assert said["active_clearance_stages"] > 0
    assert said["active_inputs"] > 0
    assert said["tightest_to_spare_m"] < 0.0


@pytest.mark.parametrize(("prepare_s", "misses"), [(0.014, 0), (0.016, 1)])
def test_both_phases_together_must_keep_the_deadline(prepare_s, misses):
    performance = Performance(sampling_time_s=0.025)
    solution = Controller().step(0.0, START)
    performance.add(replace(solution, timing=Timing(prepare_s, feedback_s=0.01)), latency_s=0.0)
    assert performance.deadline_misses == misses


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=9), st.floats(0.0, 1.0))
def test_quantiles_are_those_of_numpy(values, share):
    assert quantiles(values, (share,)) == pytest.approx([np.quantile(values, share)])
