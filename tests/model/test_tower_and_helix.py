# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The tower's clearance and the helical reference."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gtmr_model import ConfigError, Helix, Tower, Vehicle
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import Scenario, fly

HELICES = st.builds(
    Helix,
    offset_m=st.floats(0.25, 2.0),
    speed_m_s=st.floats(-1.0, 1.0).filter(bool),
    climb_m_s=st.floats(-0.2, 0.2),
    start_angle_rad=st.floats(-3.0, 3.0),
)


def test_clearance_is_the_distance_to_the_surface():
    tower = Tower(radius_m=1.5, min_clearance_m=0.3)
    points = np.array([[3.0, 4.0, 7.0], [0.0, -2.0, 1.0], [0.9, 1.2, 0.0]])
    np.testing.assert_allclose(tower.clearance(points), [3.5, 0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(tower.residual(points), [-3.2, -0.2, 0.3], atol=1e-12)


@given(HELICES, st.floats(0.0, 100.0))
def test_helix_keeps_its_offset_and_faces_the_tower(helix, t):
    tower = Tower()
    at = helix.at(t, tower)
    np.testing.assert_allclose(tower.clearance(at.position), helix.offset_m, atol=1e-9)
    facing = np.array([np.cos(at.yaw[0]), np.sin(at.yaw[0])])
    inward = -at.position[0, :2] / np.linalg.norm(at.position[0, :2])
    np.testing.assert_allclose(facing, inward, atol=1e-9)


@given(HELICES, st.floats(0.0, 100.0))
def test_helix_derivatives_are_consistent(helix, t):
    step = 1e-5
    at = helix.at([t - step, t, t + step], Tower())
    for value, rate in ((at.position, at.velocity), (at.velocity, at.acceleration)):
        difference = (value[2] - value[0]) / (2 * step)
        np.testing.assert_allclose(difference, rate[1], atol=1e-6)
    np.testing.assert_allclose((at.yaw[2] - at.yaw[0]) / (2 * step), at.yaw_rate, atol=1e-6)


def test_yaw_never_wraps_round():
    yaw = Helix().at(np.arange(0.0, 100.0, 0.025), Tower()).yaw
    assert np.abs(np.diff(yaw)).max() < 0.02


def test_flight_starts_on_the_helix_level_and_in_hover():
    helix, tower, vehicle = Helix(), Tower(), Vehicle.paper()
    x = helix.initial_state(tower, vehicle)
    start = helix.at(0.0, tower)
    np.testing.assert_array_equal(x[:3], start.position[0])
    np.testing.assert_array_equal(x[6:9], start.velocity[0])
    np.testing.assert_array_equal(x[3:5], 0.0)
    np.testing.assert_array_equal(x[12:], vehicle.hover_rotor_speeds_hz)


def test_a_helix_that_stands_still_is_refused_in_one_line():
    with pytest.raises(ConfigError, match=r"^here: speed_m_s = 0\.0: .*below 0 clockwise$"):
        Helix.parse({"speed_m_s": 0.0}, "here")


def test_a_clockwise_helix_flies():
    scenario = Scenario(helix=Helix(speed_m_s=-0.5))
    log = fly(scenario, Controller(ControllerConfig(helix=scenario.helix), "nominal"), 2.0)
    reference = scenario.helix.at(log.t, scenario.tower)
    assert np.abs(log.x[:, :3] - reference.position).max() < 0.1
    assert np.unwrap(np.arctan2(log.x[:, 1], log.x[:, 0]))[-1] < -0.6
