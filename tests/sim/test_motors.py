# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Rotors as motors: lag, limits, delay against closed forms; plans that become setpoints."""

import numpy as np
import pytest

from gtmr_model import ConfigError, Helix, Tower, Vehicle
from gtmr_sim import Plant, Scenario, Simulation, World
from gtmr_sim.worlds.motors import Motors

VEHICLE = Vehicle.paper()
START = Helix().initial_state(Tower(), VEHICLE)
LAG_S = 0.02


def plant(lag_s=LAG_S):
    return Plant(VEHICLE, np.zeros(9), START, 1e-3, world=World(motors=Motors(lag_s=lag_s)))


@pytest.mark.parametrize("lag_s", [0.02, 0.05])
def test_a_step_of_the_setpoint_is_answered_by_one_minus_exp(lag_s):
    motors, up = plant(lag_s), np.array([1.0, -1.0, 0.5, -0.5, 0.2, 0.0])
    motors.setpoints_hz = START[12:] + up
    for k in range(1, 11):
        motors.advance(np.zeros(6), np.zeros(3), 10)
        answer = START[12:] + up * (1.0 - np.exp(-0.01 * k / lag_s))
        np.testing.assert_allclose(motors.x[12:], answer, atol=1e-6)


def test_a_ramp_is_followed_a_lag_behind():
    motors, rate = plant(), np.full(6, 30.0)
    motors.advance(rate, np.zeros(3), 300)
    np.testing.assert_allclose(motors.setpoints_hz, START[12:] + 9.0, atol=1e-9)
    # xi = r (t - T (1 - exp(-t / T)))
    behind = 30.0 * LAG_S * (1.0 - np.exp(-0.3 / LAG_S))
    np.testing.assert_allclose(motors.x[12:], START[12:] + 9.0 - behind, atol=1e-5)


def test_limits_of_the_vehicle_hold_whatever_the_setpoint():
    motors = plant()
    motors.setpoints_hz = np.array([500.0, -500.0, 500.0, -500.0, 500.0, -500.0])
    motors.advance(np.zeros(6), np.zeros(3), 50)
    np.testing.assert_allclose(np.abs(motors.x[12:] - START[12:]), 200.0 * 0.05, atol=1e-9)
    motors.advance(np.zeros(6), np.zeros(3), 1000)
    assert motors.x[12:].max() <= VEHICLE.max_rotor_speed_hz + 1e-9
    assert motors.x[12:].min() >= VEHICLE.min_rotor_speed_hz - 1e-9


def simulation(**motors):
    world = World(motors=Motors(**{"lag_s": LAG_S, **motors}))
    return Simulation(Scenario(world=world, guard="hold", gust={"kind": "none"}), 0.025)


def told(seen):
    return seen.plant.setpoints_hz[0] - START[12]


def test_setpoints_are_linear_between_the_steps_of_a_plan_and_hold_at_its_end():
    seen = simulation()
    seen.command(0.0, np.zeros((2, 6)), START[12:] + np.outer([0.0, 2.0, -1.0], np.ones(6)))
    for elapsed_s, expected in ((0.01, 0.8), (0.025, 2.0), (0.035, 0.8), (0.05, -1.0), (0.1, -1)):
        seen.advance(elapsed_s - seen.time_s)
        assert told(seen) == pytest.approx(expected, abs=1e-9), elapsed_s


def test_without_setpoints_they_are_integrated_from_the_accelerations():
    seen = simulation()
    seen.command(0.0, np.outer([40.0, -20.0], np.ones(6)))
    seen.advance(0.05)
    assert told(seen) == pytest.approx(0.5, abs=1e-9)
    # A plan that follows goes on from there, and not beyond what rotors can do.
    seen.command(0.05, np.full((20, 6), 200.0))
    seen.advance(0.5)
    assert seen.plant.setpoints_hz.max() <= VEHICLE.max_rotor_speed_hz + 200.0 * 0.025 + 1e-9


def test_a_transport_delay_shifts_the_answer_and_changes_nothing_else():
    plan = np.outer([40.0, -20.0, 30.0], np.ones(6))
    quick, slow = simulation(), simulation(transport_s=0.03)
    for each in (quick, slow):
        each.command(0.0, plan)
    quick.advance(0.06)
    slow.advance(0.03)
    np.testing.assert_allclose(slow.x[12:], START[12:], atol=1e-9)
    slow.advance(0.06)
    np.testing.assert_allclose(slow.x[12:], quick.x[12:], atol=1e-6)


def test_a_plan_that_is_to_come_waits_while_the_one_in_play_goes_on():
    seen = Simulation(Scenario(guard="hold"), 0.025)
    seen.command(0.0, np.full((20, 6), 10.0))
    seen.command(0.05, np.full((20, 6), -10.0))
    seen.advance(0.05)
    np.testing.assert_allclose(seen.x[12:], START[12:] + 0.5, atol=1e-9)
    seen.advance(0.025)
    np.testing.assert_allclose(seen.x[12:], START[12:] + 0.25, atol=1e-9)


def test_a_later_plan_replaces_those_that_were_to_come_after_it():
    seen = Simulation(Scenario(guard="hold"), 0.025)
    seen.command(0.0, np.full((20, 6), 10.0))
    seen.command(0.075, np.full((20, 6), -10.0))
    seen.command(0.05, np.zeros((20, 6)))
    seen.advance(0.2)
    np.testing.assert_allclose(seen.x[12:], START[12:] + 0.5, atol=1e-9)


def test_a_lag_of_nothing_is_refused():
    with pytest.raises(ConfigError, match=r"motors.lag_s = 0: Input should be greater than 0"):
        World.parse({"motors": {"lag_s": 0}}, "world")
