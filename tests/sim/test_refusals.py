# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What cannot be flown as asked is refused in one line, never flown as something else."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from gtmr_model import ConfigError, Helix, Tower, Vehicle
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import Scenario, Simulation, fly
from gtmr_study.campaign.study import Study


class Holds:
    """Holds all rotor speeds; says nothing of the world that it is made for."""

    def step(self, t, x):
        u_plan = np.zeros((1, len(x) - 12))
        none = np.zeros(0)
        return SimpleNamespace(
            u_plan=u_plan, alpha_p=none, alpha_g=none, slack=none, status="solved",
            timing=SimpleNamespace(total_s=0.0),
        )  # fmt: skip


@pytest.mark.parametrize("period_s", [0.0333, 0.0004])
def test_a_sampling_time_that_is_no_whole_number_of_plant_steps_is_refused(period_s):
    allowed = f"sampling_time_s = {period_s:g} s: allowed is a whole number of times step_s, 0.001"
    with pytest.raises(ConfigError, match=allowed):
        Simulation(Scenario(), period_s)
    with pytest.raises(ConfigError, match=allowed):
        fly(Scenario(), Holds(), 100 * period_s, period_s)
    with pytest.raises(ConfigError, match="the plant's step_s"):
        Study.parse({"controller": {"sampling_time_s": period_s}}, "study")


def test_gusts_that_would_be_held_for_another_time_than_asked_are_refused():
    with pytest.raises(ConfigError, match=r"gust_hold_s = 0.0015 s: allowed is a whole number"):
        Scenario.parse({"gust_hold_s": 0.0015}, "scenario")


@pytest.mark.parametrize("duration_s", [-1.0, 0.0, 0.01, 1.01, math.nan, math.inf])
def test_a_duration_of_no_whole_number_of_sampling_times_is_refused(duration_s):
    with pytest.raises(ConfigError, match=r"duration_s = .* whole number of times samp"):
        fly(Scenario(), Holds(), duration_s)


def test_a_campaign_whose_flights_would_be_cut_is_refused():
    with pytest.raises(ConfigError, match=r"duration_s = 0.51 s"):
        Study.parse({"duration_s": 0.51}, "study")


@pytest.mark.parametrize(
    ("scenario", "told"),
    [
        ({"tower": Tower(radius_m=2.0)}, "tower.radius_m = 2.0: the controller is made for 1.0"),
        ({"helix": Helix(speed_m_s=1.0)}, "helix.speed_m_s = 1.0: .* made for 0.5"),
        ({"vehicle": Vehicle.preset("vehicle", "octo")}, "vehicle.name = .* made for"),
    ],
)
def test_a_controller_made_for_another_world_is_refused(scenario, told):
    with pytest.raises(ConfigError, match=told):
        fly(Scenario(**scenario), Controller(), 0.1)


@pytest.mark.usefixtures("unoptimised")
def test_a_controller_flies_at_its_own_sampling_time_and_no_other():
    controller = Controller(ControllerConfig(sampling_time_s=0.05))

    assert fly(Scenario(), controller, 0.2).t[1] == 0.05
    with pytest.raises(ConfigError, match=r"sampling_time_s = 0.025: .* made for 0.05"):
        fly(Scenario(), controller, 0.2, 0.025)


def test_a_controller_that_says_nothing_of_its_world_is_taken_as_it_is():
    octo = Scenario(vehicle=Vehicle.preset("vehicle", "octo"), tower=Tower(radius_m=2.0))
    assert len(fly(octo, Holds(), 0.1).t) == 4


def test_the_command_line_refuses_with_the_line_of_the_core(refused):
    assert refused("fly", "--duration", 1.01).startswith("gtmr: duration_s = 1.01 s: allowed is")
