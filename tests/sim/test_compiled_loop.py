# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The compiled flight is that in NumPy, to the last digit, whatever happens in it."""

import ctypes

import numpy as np
import pytest

from gtmr_codegen.library import CompileError
from gtmr_sim import GUSTS, Plant, Scenario, Simulation, World, simulation
from gtmr_sim.loop.compiled import CompiledLoop
from gtmr_sim.loop.memory import CLoop, library
from gtmr_sim.loop.reference import ReferenceLoop

LOSSY = World.load("world", "hard").model_dump() | {
    "odometry": {
        "position_std_m": 0.02,
        "attitude_std_deg": 1.0,
        "bias_std_m": 0.03,
        "delay_s": 0.04,
        "jitter_s": 0.03,
        "rate_hz": 250.0,
        "dropout": 0.3,
        "rotor_quantum_hz": 0.24,
    },
    "motors": {"lag_s": 0.04, "transport_s": 0.012},
}
WORLDS = {name: name for name in ("paper", "field", "hard")} | {"lossy": LOSSY}
GUST_SETTINGS = {
    "ou": {"std_n": 0.5},
    "dryden": {"std_n": 0.4},
    "sinusoid": {},
    "worst-case": {},
    "l1": {"sequence": [1.0, -0.5, 0.0]},
    "none": {},
    "own": {},
}


@pytest.fixture(autouse=True)
def registry(monkeypatch):
    """What a test registers is gone after it."""
    monkeypatch.setattr(GUSTS, "_registered", dict(GUSTS._registered))
    GUSTS.register("own")(lambda scenario: lambda t, p: [p[0] - 1.3, np.sin(9.0 * t), p[2] - 2.0])


def started(scenario, loop, monkeypatch):
    def no_compiler(parts):
        raise CompileError("no C compiler found")

    compiled = CompiledLoop if loop is CompiledLoop else no_compiler
    monkeypatch.setattr(simulation, "CompiledLoop", compiled)
    monkeypatch.setattr(simulation, "warn_interpreted", lambda error: None)
    flight = Simulation(scenario, 0.025)
    assert isinstance(flight._loop, loop)
    return flight


def told(flight):
    numbers = [flight.time_s, flight.plan_index, flight.guard_active, flight.guard_time_s]
    newest = flight.measured()
    measured = np.full(1 + len(flight.x), np.nan) if newest is None else [newest[0], *newest[1]]
    parts = (flight.x, flight.gust_n, flight.wind_n, flight.plant.setpoints_hz, measured)
    return np.concatenate([*parts, [*numbers, flight.least_clearance_m]])


def flown(flight, seed=0, n=120, events=None):
    """Everything told of a flight whose plans are odd, late, to come, unusable and too few."""
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(n):
        rows.append(told(flight))
        if events and k in events:
            events[k](flight)
        if k % 7 == 0 and k < 80:
            rows_of_plan = int(rng.integers(1, 30))
            u = rng.uniform(-20.0, 20.0, (rows_of_plan, 6))
            setpoints = 61.5 + rng.uniform(-2.0, 2.0, (rows_of_plan + 1, 6))
            if flight.scenario.guard == "retreat" and k == 42:
                u[0, 0] = np.nan
            stamp_s = flight.time_s + 1e-3 * int(rng.integers(-40, 60))
            flight.command(stamp_s, u, setpoints if rng.uniform() < 0.7 else None)
        flight.advance(1e-3 * int(rng.integers(1, 40)))
    return np.array(rows)


def assert_equal(scenario, monkeypatch, **given):
    compiled, reference = (
        flown(started(scenario, loop, monkeypatch), **given)
        for loop in (CompiledLoop, ReferenceLoop)
    )
    np.testing.assert_array_equal(compiled, reference)
    return compiled


def test_the_structure_is_that_of_the_header():
    assert ctypes.sizeof(CLoop) == library().gtmr_loop_size()


@pytest.mark.parametrize("guard", ["retreat", "hold"])
@pytest.mark.parametrize("world", WORLDS)
def test_flights_are_the_same_in_every_world(world, guard, monkeypatch):
    for seed in range(3):
        scenario = Scenario(world=WORLDS[world], seed=seed, guard=guard).sampled()
        rows = assert_equal(scenario, monkeypatch, seed=seed)
    assert rows[-1, -3] == (guard == "retreat")


@pytest.mark.parametrize("gust", GUST_SETTINGS)
def test_flights_are_the_same_in_every_gust(gust, monkeypatch):
    settings = {"kind": gust, **GUST_SETTINGS[gust]}
    for world in ("paper", "lossy"):
        scenario = Scenario(world=WORLDS[world], seed=4, gust=settings).sampled()
        # Longer than what is drawn ahead at once.
        assert_equal(scenario, monkeypatch, n=220)


def test_a_plan_longer_than_any_before_finds_room_and_so_do_many_to_come(monkeypatch):
    def many(flight):
        for ahead in range(12):
            u = np.full((70 - ahead, 6), 0.5 * (-1.0) ** ahead)
            flight.command(flight.time_s + 0.02 * ahead, u)

    scenario = Scenario(guard="hold", seed=2).sampled()
    assert_equal(scenario, monkeypatch, events={15: many})


def test_what_changes_in_flight_changes_both(monkeypatch):
    class Stuck(Plant):
        def advance(self, u, w_g, steps):
            super().advance(np.r_[0.0, np.asarray(u)[1:]], w_g, steps)

    def replace(kind):
        def put(flight):
            met, old = flight.scenario, flight.plant
            flight.plant = kind(met.vehicle, old.zeta, old.x, met.step_s, met.tower)

        return put

    def move(flight):
        flight.plant.x = flight.x + 0.01

    def reconfigure(flight):
        zeta = (*[0.05] * 6, 0.2, 0.1, 0.0)
        update = {"zeta": zeta, "gust": flight.scenario.gust.model_copy(update={"std_n": 0.1})}
        flight.reconfigure(flight.scenario.model_copy(update=update))

    for world in ("paper", "hard"):
        events = {5: move, 21: reconfigure, 33: lambda flight: flight.reset()}
        if world == "paper":
            events |= {45: replace(Stuck), 60: replace(Plant)}
        scenario = Scenario(world=world, seed=6).sampled()
        assert_equal(scenario, monkeypatch, events=events)


def test_what_a_plant_of_ones_own_raises_reaches_the_caller(monkeypatch):
    class Broken(Plant):
        def advance(self, u, w_g, steps):
            raise RuntimeError("no more fuel")

    flight = started(Scenario(), CompiledLoop, monkeypatch)
    met, old = flight.scenario, flight.plant
    flight.plant = Broken(met.vehicle, old.zeta, old.x, met.step_s, met.tower)
    with pytest.raises(RuntimeError, match="no more fuel"):
        flight.advance(0.1)


@pytest.mark.parametrize("shape", [(20, 5), (20,), (0, 6, 1)])
def test_a_plan_of_another_shape_is_refused_where_no_guard_takes_charge(shape):
    with pytest.raises(ValueError, match=r"u_plan has shape .*, expected \(N, 6\)"):
        Simulation(Scenario(guard="hold"), 0.025).command(0.0, np.zeros(shape))
