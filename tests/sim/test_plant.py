# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The plant: accuracy against SciPy, limits, and its own parameters."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from gtmr_model import Helix, Tower, UncertaintySet, Vehicle, dynamics
from gtmr_sim import Plant, Scenario, Simulation

VEHICLE = Vehicle.paper()
START = Helix().initial_state(Tower(), VEHICLE)


def test_plant_agrees_with_a_tight_scipy_integration():
    zeta = UncertaintySet().vertices()[77]
    u, w_g = np.array([30.0, -20.0, 10.0, 5.0, -40.0, 25.0]), np.array([0.3, -0.2, 0.4])
    plant = Plant(VEHICLE, zeta, START, 1e-3)
    plant.advance(u, w_g, 200)
    reference = solve_ivp(
        lambda _, x: dynamics(x, u, zeta, w_g, VEHICLE), (0.0, 0.2), START, rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(plant.x, reference.y[:, -1], atol=1e-9)


@settings(max_examples=25)
@given(st.lists(st.floats(-1e4, 1e4), min_size=6, max_size=6), st.integers(1, 400))
def test_rotor_speed_and_acceleration_limits_hold_whatever_is_commanded(u, steps):
    plant = Plant(VEHICLE, np.zeros(9), START, 1e-3)
    plant.advance(u, np.zeros(3), steps)
    xi = plant.x[12:]
    assert (xi >= VEHICLE.min_rotor_speed_hz - 1e-9).all()
    assert (xi <= VEHICLE.max_rotor_speed_hz + 1e-9).all()
    most = VEHICLE.max_rotor_acceleration_hz_s * steps * 1e-3
    assert (np.abs(xi - START[12:]) <= most + 1e-9).all()


def test_flight_is_the_same_however_time_is_cut_up():
    plan = 40.0 * np.sin(np.arange(120.0)).reshape(20, 6)
    whole, pieces = (Simulation(Scenario(seed=3), 0.025) for _ in range(2))
    for simulation in (whole, pieces):
        simulation.command(0.0, plan)
    whole.advance(0.3)
    for _ in range(60):
        pieces.advance(0.005)
    assert pieces.time_s == whole.time_s
    np.testing.assert_allclose(pieces.x, whole.x, atol=1e-12)


def test_missing_commands_are_bridged_by_the_rest_of_the_plan_then_by_holding_speed():
    simulation = Simulation(Scenario(guard="hold"), 0.025)
    plan = np.full((4, 6), 10.0)
    simulation.command(0.0, plan)
    simulation.advance(0.1)
    at_the_end_of_the_plan = simulation.x[12:]
    np.testing.assert_allclose(at_the_end_of_the_plan, START[12:] + 1.0)
    simulation.advance(0.1)
    np.testing.assert_array_equal(simulation.x[12:], at_the_end_of_the_plan)


def test_late_plan_is_played_from_where_it_should_be_by_now():
    simulation = Simulation(Scenario(guard="hold"), 0.025)
    simulation.advance(0.05)
    simulation.command(0.0, np.arange(4.0)[:, None] * np.ones(6))
    simulation.advance(0.025)
    np.testing.assert_allclose(simulation.x[12:], START[12:] + 2.0 * 0.025)


def test_reset_repeats_the_same_flight():
    simulation = Simulation(Scenario(seed=5), 0.025)
    simulation.advance(0.5)
    first = simulation.x
    simulation.reset()
    assert simulation.time_s == 0.0
    simulation.advance(0.5)
    np.testing.assert_array_equal(simulation.x, first)


def test_plants_in_four_threads_fly_as_each_does_alone():
    def fly_on(seed):
        plant = Plant(VEHICLE, np.zeros(9), START, 1e-3)
        # Long enough in compiled code that the threads overlap there.
        for _ in range(5):
            plant.advance(np.full(6, float(seed)), np.zeros(3), 2000)
        return plant.x.tobytes()

    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(fly_on, range(8)))

    assert together == [fly_on(seed) for seed in range(8)]
