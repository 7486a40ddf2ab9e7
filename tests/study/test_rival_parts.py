# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What rivals are made of: wrench, attitude, filter, gain, and what an oracle sees."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gtmr_model import N_ZETA, Vehicle, dynamics
from gtmr_model.dynamics import ROTORS, rotation
from gtmr_nmpc import ControllerConfig
from gtmr_nmpc.observer import GUST, InterpretedObserver
from gtmr_sim import Scenario, Simulation, World, fly
from gtmr_study.rivals.feedback.indi import Butterworth
from gtmr_study.rivals.feedback.lqr import INPUT_WEIGHT, LqrParameters, gain, trim
from gtmr_study.rivals.feedback.wrench import (
    ROTOR_LOOP_S,
    Wrench,
    attitude_error,
    rotation_of,
)
from gtmr_study.rivals.oracle import Oracle, OracleParameters, Truth

VEHICLE = Vehicle.paper()
HOVER = VEHICLE.hover_rotor_speeds_hz
WEIGHT = VEHICLE.allocation @ HOVER**2
angles = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)
changes = st.tuples(*[st.floats(-1.0, 1.0)] * 6).map(np.array)


def speeds_for(wrench, vehicle=VEHICLE):
    rotors = Wrench(vehicle)
    at = vehicle.hover_rotor_speeds_hz
    return at + ROTOR_LOOP_S * rotors.rotor_accelerations(wrench, at), (
        rotors.force_is_limited,
        rotors.torque_is_limited,
    )


@given(changes)
def test_rotors_go_to_the_speeds_that_make_the_wrench(change):
    wanted = WEIGHT + change * [2.0, 2.0, 5.0, 0.5, 0.5, 0.5]
    speeds, limited = speeds_for(wanted)

    assert limited == (False, False)
    assert VEHICLE.allocation @ speeds**2 == pytest.approx(wanted, abs=1e-9)


@given(changes.filter(lambda change: np.abs(change[:3]).max() > 0.1))
def test_of_too_much_the_torque_goes_first_and_the_force_is_scaled_towards_hover(change):
    wanted = WEIGHT + change * [1e3, 1e3, 1e3, 0.5, 0.5, 0.5]
    speeds, limited = speeds_for(wanted)
    given_more, asked_more = VEHICLE.allocation @ speeds**2 - WEIGHT, wanted - WEIGHT

    assert limited == (True, False)
    assert speeds.min() > VEHICLE.min_rotor_speed_hz - 1e-9
    assert speeds.max() < VEHICLE.max_rotor_speed_hz + 1e-9
    assert given_more[3:] == pytest.approx(asked_more[3:], abs=1e-9)
    share = given_more[:3] @ asked_more[:3] / (asked_more[:3] @ asked_more[:3])
    assert 0.0 < share < 1.0
    assert given_more[:3] == pytest.approx(share * asked_more[:3], abs=1e-9)


@given(changes.filter(lambda change: np.abs(change[3:]).max() > 0.1))
def test_too_much_torque_is_scaled_and_leaves_rotors_within_limits(change):
    speeds, limited = speeds_for(WEIGHT + 1e3 * change)
    turned, asked = (VEHICLE.allocation @ speeds**2 - WEIGHT)[3:], 1e3 * change[3:]

    assert limited[1]
    assert speeds.min() > VEHICLE.min_rotor_speed_hz - 1e-9
    assert speeds.max() < VEHICLE.max_rotor_speed_hz + 1e-9
    assert turned == pytest.approx((turned @ asked) / (asked @ asked) * asked, abs=1e-9)


@given(angles)
def test_the_rotation_is_that_of_the_model(eta):
    assert rotation_of(eta) == pytest.approx(np.array(ca.DM(rotation(ca.DM(eta)))), abs=1e-14)


def test_a_small_attitude_error_is_the_angle():
    for turn in 1e-4 * np.eye(3):
        assert attitude_error(rotation_of(turn), np.eye(3)) == pytest.approx(turn, abs=1e-8)


def test_only_a_vehicle_that_must_tilts_towards_a_force():
    force, yaw = np.array([3.0, -2.0, 20.0]), 0.7
    level = Wrench(VEHICLE).attitude_for(force, yaw)
    tilted = Wrench(Vehicle.preset("vehicle", "quad")).attitude_for(force, yaw)

    assert level == pytest.approx(rotation_of(np.array([0.0, 0.0, yaw])))
    assert tilted[:, 2] == pytest.approx(force / np.linalg.norm(force))
    assert tilted.T @ tilted == pytest.approx(np.eye(3), abs=1e-12)
    assert np.arctan2(tilted[1, 0], tilted[0, 0]) == pytest.approx(yaw, abs=0.02)


@pytest.mark.parametrize("name", ["paper", "quad", "octo"])
def test_the_trim_of_an_lqr_is_an_equilibrium(name):
    vehicle = Vehicle.preset("vehicle", name)
    hover = vehicle.hover_rotor_speeds_hz
    push = np.array([0.3, -0.2, 0.1])
    wrench = vehicle.allocation @ hover**2 - np.r_[push, 0.0, 0.0, 0.0]
    tilt, squared = np.split(trim(vehicle) @ wrench, [2])
    x = np.r_[np.zeros(3), tilt, np.zeros(7), np.sqrt(squared)]
    rate = dynamics(x, np.zeros(vehicle.n_rotors), np.zeros(N_ZETA), push, vehicle)

    assert rate[6:12] == pytest.approx(np.zeros(6), abs=2e-3)
    assert (np.abs(tilt).max() > 0.01) == (name == "quad")


def test_the_gain_of_an_lqr_is_the_limit_of_dynamic_programming():
    """By value iteration on differences of the nonlinear model, by Euler steps of 1 ms."""
    by = LqrParameters()
    n, dt, fine = VEHICLE.n_x, 0.025, 1e-3

    def flow(z):
        x, u = z[:n].copy(), z[n:]
        for _ in range(round(dt / fine)):
            x += fine * dynamics(x, u, np.zeros(N_ZETA), np.zeros(3), VEHICLE)
        return x

    z = np.r_[np.zeros(12), HOVER, np.zeros(6)]
    steps = 1e-4 * np.eye(z.size)
    a, b = np.split(np.array([flow(z + h) - flow(z - h) for h in steps]).T / 2e-4, [n], axis=1)
    q = np.repeat([by.position, by.attitude, by.velocity, by.rate], 3)
    q = np.diag(np.r_[q, np.full(6, INPUT_WEIGHT)])
    p = q
    for _ in range(1500):
        k = np.linalg.solve(INPUT_WEIGHT * np.eye(6) + b.T @ p @ b, b.T @ p @ a)
        p = q + a.T @ p @ (a - b @ k)

    ours = gain(VEHICLE, dt, by)
    assert np.abs(ours - k).max() < 0.02 * np.abs(k).max()


@settings(max_examples=20)
@given(st.floats(1.0, 40.0))
def test_the_filter_keeps_what_is_steady_and_halves_the_power_at_its_cut_off(cutoff_rad_s):
    steady, wave = (Butterworth(cutoff_rad_s, 0.025) for _ in range(2))
    assert [steady(np.array([3.0]))[0] for _ in range(5)] == pytest.approx([3.0] * 5)

    period_s = 2.0 * np.pi / cutoff_rad_s
    t = 0.025 * np.arange(round(20.0 * period_s / 0.025))
    out = np.array([wave(np.array([np.sin(cutoff_rad_s * s)]))[0] for s in t])
    late = t > 10.0 * period_s
    assert np.sqrt(2.0 * np.mean(out[late] ** 2)) == pytest.approx(np.sqrt(0.5), rel=0.06)


@pytest.fixture
def hard_flight():
    """A flight in the world ``hard``, some way from its start, and an oracle's view of it."""
    scenario = Scenario(seed=5, world="hard", guard="hold").sampled()
    simulation = Simulation(scenario, 0.025)
    simulation.command(0.0, np.tile([20.0, -10.0, 5.0, 0.0, -20.0, 10.0], (40, 1)))
    simulation.advance(0.4)
    truth = Truth(ControllerConfig())
    truth.simulation = simulation
    return simulation, truth


def test_what_an_oracle_sees_predicts_what_the_plant_does(hard_flight):
    simulation, truth = hard_flight
    x, _ = truth.update(np.zeros(18), 0.025)
    blind = InterpretedObserver(ControllerConfig())
    simulation.advance(0.005)
    true = simulation.x
    seen, unseen = (o.ahead(x, true[ROTORS], 0.005)[:12] - true[:12] for o in (truth, blind))

    assert np.abs(seen).max() < 1e-4 < 0.05 * np.abs(unseen).max()


def test_an_oracle_sees_the_gust_of_now_and_changes_nothing(hard_flight):
    simulation, truth = hard_flight
    before, plant = simulation.x.copy(), simulation.plant
    theta = truth.update(np.zeros(18), 0.025).theta

    assert simulation.plant is plant
    assert (simulation.x == before).all()
    mass = 1.0 + simulation.scenario.zeta_array[0]
    assert theta[GUST] == pytest.approx(simulation.gust_n / mass)


def test_only_what_asks_for_the_truth_is_handed_it():
    world = World.preset("world", "hard")
    scenario = Scenario(seed=5, world=world, guard="hold").sampled()
    oracle = Oracle(ControllerConfig(delay_s=0.05, motor_lag_s=0.05), OracleParameters())
    log = fly(scenario, oracle, 2.0)

    assert log.tracking_error_m[40:].max() < 0.02
    assert np.abs(log.x - log.x_measured)[:, :3].max() > 0.02, "what it flew on was no measurement"
