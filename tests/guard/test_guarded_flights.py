# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Flights whose commands stop: clear of the tower, and on when they come again."""

import numpy as np
import pytest

from gtmr_guard import GuardConfig
from gtmr_nmpc import Controller
from gtmr_sim import Scenario, Simulation, fly
from gtmr_sim.session import Session

T_S = 0.025
WORST = np.array([0.1, 0.15, 0.15, 0.2, 0.1, 0.2, 0.8, 0.8, 0.3])


def scenario(seed, guard="retreat"):
    """Give a corner of the uncertainty box under the full gust; odd seeds a random flight."""
    if seed % 2:
        return Scenario(seed=seed, guard=guard).sampled()
    zeta = np.random.default_rng(seed).choice([-1, 1], 9) * WORST
    return Scenario(seed=seed, guard=guard, zeta=tuple(zeta), gust={"kind": "worst-case"})


class Flight:
    """What happens in a flight whose controller is silent for a while, every 5 ms."""

    def __init__(self, seed, silence_s, after_s, guard="retreat"):
        world = scenario(seed, guard)
        simulation, controller = Simulation(world, T_S), Controller()
        self.cut = round(np.random.default_rng(seed).uniform(0.5, 2.5) / T_S)
        silent = range(self.cut, self.cut + round(silence_s / T_S))
        rows = []
        for k in range(silent.stop + round(after_s / T_S)):
            if k not in silent:
                simulation.command(k * T_S, controller.step(k * T_S, simulation.x).u_plan)
            for _ in range(5):
                simulation.advance(0.005)
                rows.append((simulation.time_s, simulation.guard_active, *simulation.x))
        self.t, active, self.x = (a := np.array(rows))[:, 0], a[:, 1], a[:, 2:]
        self.active = active.astype(bool)
        self.d_T = world.tower.clearance(self.x)
        self.speed = np.linalg.norm(self.x[:, 6:9], axis=1)
        self.ended = self.cut * T_S - T_S
        """Time of the last plan before the silence [s]."""
        self.resumed = silent.stop * T_S


@pytest.mark.parametrize("silence_s", [0.6, 0.75, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("seed", range(4))
def test_bursts_of_lost_commands_leave_it_clear_and_the_controller_goes_on(silence_s, seed):
    flight = Flight(seed, silence_s, after_s=2.0)
    assert flight.d_T.min() >= 0.2
    silent = (flight.t > flight.ended) & (flight.t <= flight.resumed)
    assert flight.active[silent].any()
    # Within 50 ms of the age at which a plan is too old, which is before its end.
    taken = flight.t[flight.active][0] - flight.ended
    assert taken <= GuardConfig().max_plan_age_s + 0.05 <= 0.5
    assert not flight.active[-1]


@pytest.mark.parametrize("seed", range(6))
def test_with_the_controller_dead_it_hovers_clear_of_the_tower(seed):
    flight = Flight(seed, silence_s=10.0, after_s=0.0)
    assert flight.d_T.min() >= 0.2
    assert flight.d_T[-1] == pytest.approx(GuardConfig().retreat_clearance_m, abs=0.1)
    assert flight.speed[-1] < 0.2
    assert flight.active[-1]


def test_holding_rotor_speeds_instead_flies_into_the_tower_or_away():
    """The check above can fail: it does where there is no guard."""
    flights = [Flight(seed, silence_s=10.0, after_s=0.0, guard="hold") for seed in range(2)]
    assert all(f.speed[-1] > 1.0 or f.d_T.min() < 0.2 for f in flights)


@pytest.mark.parametrize("seed", range(3))
def test_hand_back_makes_no_bump(seed):
    """Neither rotor speeds nor attitude jump, and the way back to the controller takes 0.2 s."""
    flight = Flight(seed, silence_s=1.0, after_s=2.0)
    most = Scenario().vehicle.max_rotor_acceleration_hz_s * 0.005
    assert np.abs(np.diff(flight.x[:, 12:], axis=0)).max() <= most + 1e-9
    back = flight.t[flight.active][-1]
    assert flight.resumed < back <= flight.resumed + 0.2
    after = flight.t > back
    tilt = np.arccos(np.cos(flight.x[after, 3]) * np.cos(flight.x[after, 4]))
    assert np.degrees(tilt.max()) < 20.0
    # Once per silence: it does not come and go.
    assert np.count_nonzero(np.diff(flight.active.astype(int)) == 1) == 1


@pytest.mark.parametrize("mode", ["nominal", "robust"])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_flight_without_faults_is_the_same_bit_for_bit_with_and_without_it(mode, seed):
    guarded, held = (
        fly(scenario(seed, guard), Controller(mode=mode), 4.0) for guard in ("retreat", "hold")
    )
    assert not guarded.guard.any()
    assert guarded.x.tobytes() == held.x.tobytes()
    assert guarded.u.tobytes() == held.u.tobytes()


def test_hold_holds_rotor_speeds_past_the_plan():
    simulation = Simulation(Scenario(guard="hold"), T_S)
    simulation.command(0.0, np.full((4, 6), 10.0))
    simulation.advance(0.1)
    at_the_end = simulation.x[12:]
    simulation.advance(2.0)
    np.testing.assert_array_equal(simulation.x[12:], at_the_end)
    assert not simulation.guard_active
    assert simulation.guard_cause == ""


def test_a_guarded_flight_is_the_same_however_time_is_cut_up():
    whole, pieces = (Simulation(Scenario(seed=3), T_S) for _ in range(2))
    for simulation in (whole, pieces):
        simulation.command(0.0, np.zeros((4, 6)))
    whole.advance(2.0)
    for _ in range(1000):
        pieces.advance(0.002)
    assert whole.guard_active
    assert pieces.guard_time_s == whole.guard_time_s == pytest.approx(2.0 - 0.125)
    np.testing.assert_array_equal(pieces.x, whole.x)


def test_reset_forgets_that_it_was_in_charge():
    simulation = Simulation(Scenario(seed=5), T_S)
    simulation.advance(1.0)
    first = simulation.x
    assert simulation.guard_cause == "plan ended"
    simulation.reset()
    assert not simulation.guard_active
    assert simulation.guard_time_s == 0.0
    simulation.advance(1.0)
    np.testing.assert_array_equal(simulation.x, first)


def test_a_session_tells_of_the_guard():
    session = Session(Simulation(Scenario(), T_S), T_S, 0.005, False, 0.0)
    session.command(0, np.zeros((20, 6)))
    while session.stamp_ns < 250_000_000:
        session.advance()
    assert not session.guard_active
    while session.stamp_ns < 350_000_000:
        session.advance()
    assert session.guard_active
    assert session.guard_cause == "plan ended"
    assert session.guard_time_s > 0.0


def test_a_controller_that_plans_seldom_may_miss_plans_and_gets_the_vehicle_back():
    simulation = Simulation(Scenario(gust={"kind": "none"}), 0.2)
    simulation.command(0.0, np.zeros((20, 6)))
    simulation.advance(0.4)
    assert not simulation.guard_active
    simulation.advance(0.4)
    assert simulation.guard_active
    for k in range(4, 7):
        simulation.command(0.2 * k, np.zeros((20, 6)))
        simulation.advance(0.2)
    assert not simulation.guard_active


def test_the_flight_log_says_when_it_was_in_charge():
    class Silent:
        def step(self, t, x):
            return np.full(6, 3e3) if t > 0.1 else np.zeros(6)

    log = fly(Scenario(), Silent(), 0.2)
    assert log.guard.shape == log.t.shape
    np.testing.assert_array_equal(log.guard, log.t > 0.1)
