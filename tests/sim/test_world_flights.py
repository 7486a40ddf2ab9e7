# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Flights in worlds: the paper's stays what it was, and whoever controls can fly in any other."""

import inspect

import numpy as np
import pytest

from gtmr_model import ConfigError, Helix
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import FlightError, Scenario, Simulation, World, fly, plant
from gtmr_sim.worlds.sensor import Odometry

WORLDS = ("paper", "field", "hard")


def scenario(world, seed=0, guard="retreat", **fields):
    return Scenario(world=world, seed=seed, guard=guard, **fields).sampled()


def controller(world, mode="offset_free"):
    return Controller(
        ControllerConfig.load("controller", "default" if world == "paper" else world), mode=mode
    )


def rows(log):
    return {
        name: value
        for name, value in vars(log).items()
        if name not in ("solve_ms", "x_measured", "wind_n")
    }


def test_the_world_that_is_named_paper_is_the_one_that_is_left_out():
    assert World.load("world", "paper") == World() == Scenario().world
    named, plain = (
        fly(s, controller("paper", "robust"), 1.0)
        for s in (scenario("paper"), Scenario().sampled())
    )
    for name, value in rows(named).items():
        np.testing.assert_array_equal(value, rows(plain)[name], name)
    np.testing.assert_array_equal(named.x_measured, named.x)


@pytest.mark.parametrize("mode", ["robust", "offset_free"])
@pytest.mark.parametrize("seed", range(3))
def test_in_the_field_the_guard_never_takes_charge_and_changes_nothing(mode, seed):
    guarded, alone = (
        fly(scenario("field", seed, guard), controller("field", mode), 4.0)
        for guard in ("retreat", "hold")
    )
    assert not guarded.guard.any()
    np.testing.assert_array_equal(guarded.x, alone.x)
    assert guarded.least_clearance_m > 0.2


@pytest.mark.parametrize("seed", range(3))
def test_told_of_it_the_controller_is_at_home_where_it_is_hard_and_needs_no_guard(seed):
    log = fly(scenario("hard", seed), controller("hard"), 4.0)
    assert not log.guard.any()
    assert log.least_clearance_m > 0.25


@pytest.mark.parametrize("world", ["field", "hard"])
@pytest.mark.parametrize("seed", range(3))
def test_where_commands_end_the_guard_moves_away_and_hovers(world, seed):
    met, pilot = scenario(world, seed, gust={"kind": "worst-case"}), controller(world)
    flight = Simulation(met, 0.025)
    delay_s = met.world.odometry.delay_s
    for k in range(480):
        newest = flight.measured()
        if newest is not None and k < 80:
            now_s = newest[0] + delay_s
            solution = pilot.step(*newest, now=now_s)
            flight.command(now_s, solution.u_plan, solution.setpoints_hz)
        assert not flight.guard_active or k > 80
        flight.advance(0.025)
    assert flight.guard_active
    assert flight.least_clearance_m > 0.2
    assert met.tower.clearance(flight.x) == pytest.approx(1.0, abs=0.1)


class Plain:
    """Says only rotor accelerations, and knows nothing of delays: a pilot of the old kind."""

    def __init__(self):
        self.stamps = []
        self._own = Controller(mode="robust")

    def step(self, t, x):
        self.stamps.append(t)
        return self._own.step(t, x).u


@pytest.mark.parametrize("world", WORLDS)
def test_a_controller_that_gives_accelerations_alone_flies_in_every_world(world):
    pilot = Plain()
    log = fly(scenario(world), pilot, 1.0)
    assert np.isfinite(log.x).all()
    assert log.alpha_p.shape == (40, 0)
    late = round(scenario(world).world.odometry.delay_s / 0.025)
    # Stamps are those of what was measured; only a jitter makes one newer.
    assert len(pilot.stamps) >= 40 - 2 * late
    assert np.all(np.diff(pilot.stamps) > 0.0)


def test_a_step_that_takes_now_is_told_when_its_plan_begins():
    told = []

    class Listens:
        def step(self, t, x, now=None):
            told.append((t, now))
            return np.zeros(6)

    assert "now" in inspect.signature(Listens.step).parameters
    late = World(odometry=Odometry(delay_s=0.05))
    fly(scenario(late, guard="hold"), Listens(), 0.25)
    assert told == [(pytest.approx(t), pytest.approx(t + 0.05)) for t, _ in told]
    told.clear()
    fly(scenario("paper", guard="hold"), Listens(), 0.1)
    assert {now for _, now in told} == {None}


@pytest.mark.parametrize(
    ("setpoints", "reason"),
    [
        (np.zeros((20, 6)), r"shape \(20, 6\), expected \(21, 6\)"),
        (np.full((21, 6), np.nan), "nan"),
    ],
)
def test_setpoints_that_no_motor_can_follow_are_refused(setpoints, reason):
    class Odd:
        def step(self, t, x):
            return type("", (), {"u_plan": np.zeros((20, 6)), "setpoints_hz": setpoints})

    with pytest.raises(FlightError, match=reason):
        fly(scenario("field"), Odd(), 0.1)


@pytest.mark.parametrize("world", WORLDS)
def test_the_same_seed_is_the_same_flight(world):
    first, again = (fly(scenario(world, 3), controller(world), 0.5) for _ in range(2))
    for name, value in rows(first).items():
        np.testing.assert_array_equal(value, rows(again)[name], name)


def test_the_least_clearance_is_that_of_every_plant_step():
    flown = fly(scenario("paper"), controller("paper", "nominal"), 1.0)
    again, steps = Simulation(scenario("paper"), 0.025), []
    for k in range(40):
        again.command(0.025 * k, controller_plan(flown, k))
        for _ in range(25):
            steps.append(again.scenario.tower.clearance(again.x))
            again.advance(0.001)
    steps.append(again.scenario.tower.clearance(again.x))
    assert again.least_clearance_m == pytest.approx(min(steps), abs=1e-12)
    assert flown.least_clearance_m == pytest.approx(min(steps), abs=1e-9)
    assert flown.least_clearance_m <= flown.d_T.min()


def controller_plan(log, k):
    return log.u[k : k + 1]


def test_interpreted_worlds_fly_as_compiled_ones():
    met = World.load("world", "hard")
    step = plant._plant_step(Scenario().vehicle, 1e-3, Scenario().tower, (), met.in_plant)
    start = Helix().initial_state(Scenario().tower, Scenario().vehicle)
    memory = np.concatenate(
        (start, start[12:] + 1.0, np.ones(6), np.full(9, 0.1), np.zeros(3), [1.0, -2.0, 0.1, 9.0])
    )
    expected = memory.copy()
    plant._interpreted(step, expected, 20)
    plant._compiled(step)(memory, 20)
    np.testing.assert_allclose(memory, expected, rtol=1e-14)
    assert memory[-1] < 1.9


def test_shares_of_the_bound_are_played_inward_over_and_over():
    met = Scenario(guard="hold", gust={"kind": "l1", "sequence": [1.0, -0.5, 0.0]})
    log = fly(met, Plain(), 0.2)
    inward = -log.x[:, :2] / np.hypot(*log.x[:, :2].T)[:, None]
    pushed = (log.w_g[:, :2] * inward).sum(axis=1)
    np.testing.assert_allclose(pushed, 0.6 * np.resize([1.0, -0.5, 0.0], 8), atol=1e-12)


@pytest.mark.parametrize("gust", [{"kind": "l1"}, {"kind": "l1", "sequence": [0.0, 0.0]}])
def test_a_sequence_that_pushes_nowhere_is_refused(gust):
    with pytest.raises(ConfigError, match=r"gust.sequence = \[0.0.*needs shares of the bound"):
        Scenario.parse({"gust": gust}, "scenario")


def test_a_world_that_is_not_there_is_refused():
    with pytest.raises(ConfigError, match="there is field, hard, paper, or a YAML file"):
        Scenario.parse({"world": "moon"}, "scenario")
