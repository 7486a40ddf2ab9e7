# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A closed loop in one call is the one step by step, to the last digit but for solve times."""

import ctypes
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import FlightError, Scenario, World, fly
from gtmr_sim.flying.native import native_step
from gtmr_sim.loop.memory import CFlight, library

STATUSES = ("solved", "softened", "failed", "limited")
LATE = World.parse(
    {
        "odometry": {"delay_s": 0.06, "jitter_s": 0.05, "dropout": 0.3, "position_std_m": 0.01},
        "motors": {"lag_s": 0.03, "transport_s": 0.01},
    },
    "world",
)
StepFunction = ctypes.CFUNCTYPE(
    ctypes.c_int,
    ctypes.c_void_p,
    ctypes.c_double,
    ctypes.POINTER(ctypes.c_double),
    ctypes.c_double,
    ctypes.POINTER(ctypes.c_double),
)


class Stepwise:
    """A controller without its offer to callers in C."""

    def __init__(self, own):
        self._own, self.config, self.mode = own, own.config, own.mode

    def step(self, t, x, now=None):
        return self._own.step(t, x, now)


class Called(Stepwise):
    """A controller whose step in C calls it back."""

    calls = 0

    def native(self):
        n, n_rotors = self.config.horizon, self.config.vehicle.n_rotors
        shapes = {
            "alpha_p": (n + 1,),
            "setpoints_hz": (n + 1, n_rotors),
            "alpha_g": (n + 1,),
            "u_plan": (n, n_rotors),
            "slack": (n + 1,),
        }
        parts, end = {}, 5
        for name, shape in shapes.items():
            parts[name] = (end, shape)
            end += int(np.prod(shape))

        def step(_, t, x, now, plan):
            self.calls += 1
            try:
                given = self.step(t, np.array(x[: self.config.vehicle.n_x]), now)
            except ValueError:
                return -1
            for name, (start, shape) in parts.items():
                flat = np.ravel(getattr(given, name))
                for i in range(int(np.prod(shape))):
                    plan[start + i] = flat[i]
            return STATUSES.index(given.status)

        self.kept = StepFunction(step)
        return SimpleNamespace(
            function=ctypes.cast(self.kept, ctypes.c_void_p).value,
            memory=0,
            plan_length=end,
            parts=parts,
            statuses=STATUSES,
        )


def config(world):
    return ControllerConfig.load("controller", world if world in ("field", "hard") else "default")


def scenario(world, **fields):
    return Scenario(world=LATE if world == "late" else world, **fields).sampled()


def assert_same(one, other):
    for name, value in vars(one).items():
        if name != "solve_ms" and isinstance(value, np.ndarray | float):
            np.testing.assert_array_equal(value, vars(other)[name], name)
    assert (one.solve_ms > 0.0).all()
    assert one.solve_ms.shape == other.solve_ms.shape


def test_the_structure_is_that_of_the_header():
    assert ctypes.sizeof(CFlight) == library().gtmr_flight_size()


@pytest.mark.parametrize("guard", ["retreat", "hold"])
@pytest.mark.parametrize("world", ["paper", "field", "hard", "late"])
@pytest.mark.parametrize("kind", [Called, Controller])
def test_flights_are_the_same_in_every_world(kind, world, guard):
    for seed, mode in enumerate(("nominal", "robust", "offset_free")):
        met = scenario(world, seed=seed, guard=guard)
        flies = Controller(config(world), mode)
        if kind is Called:
            flies = Called(flies)
        in_one = fly(met, flies, 1.5)
        by_step = fly(met, Stepwise(Controller(config(world), mode)), 1.5)
        assert_same(in_one, by_step)
        assert in_one.mode == mode
    if kind is Called:
        assert flies.calls > 20


class Wild:
    """Plans at random, fails at times, and commands at times what makes the guard take charge."""

    config, mode = ControllerConfig(), "wild"

    def __init__(self):
        self._rng = np.random.default_rng(1)

    def step(self, t, x, now):
        draw, n = self._rng.uniform, self.config.horizon
        u_plan = draw(-10.0, 10.0, (n, 6))
        if draw() < 0.1:
            u_plan[0] = 1e6
        return SimpleNamespace(
            u_plan=u_plan,
            setpoints_hz=draw(55.0, 65.0, (n + 1, 6)),
            **{name: draw(0.0, 1.0, n + 1) for name in ("alpha_p", "alpha_g", "slack")},
            status=STATUSES[int(draw(0.0, 4.0))],
        )


@pytest.mark.parametrize("world", ["paper", "late"])
def test_what_a_wild_controller_tells_is_kept_as_step_by_step(world):
    met = scenario(world, seed=2)
    logs = [fly(met, kind(Wild()), 1.5) for kind in (Called, Stepwise)]
    assert_same(*logs)
    assert 5 < logs[0].failed_steps < 40
    assert 5 < logs[0].guard.sum() < 60


def test_flights_in_four_threads_are_those_of_one():
    def flight(k):
        world, mode = ("paper", "hard")[k % 2], ("nominal", "offset_free")[k // 2 % 2]
        log = fly(scenario(world, seed=k), Controller(config(world), mode), 1.0)
        return log.x.tobytes() + log.alpha_p.tobytes()

    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(flight, range(12)))

    assert together == [flight(k) for k in range(12)]


def test_one_flight_after_another_with_the_same_controller():
    both = [Called(Controller()), Stepwise(Controller())]
    for seed in range(2):
        assert_same(*(fly(scenario("paper", seed=seed), each, 0.5) for each in both))


def test_progress_is_told_up_to_the_last_step():
    told = []
    fly(scenario("paper"), Called(Controller()), 2.25, on_step=told.append)
    assert told[-1] == 90
    assert len(told) > 1
    assert told == sorted(set(told))


def test_a_step_of_ones_own_is_not_passed_over():
    class Own(Called):
        def step(self, t, x, now=None):
            return super().step(t, x, now)

    assert native_step(Called(Controller())) is not None
    assert native_step(Own(Controller())) is None
    changed = Called(Controller())
    changed.step = lambda t, x: np.zeros(6)
    assert native_step(changed) is None
    assert native_step(Stepwise(Controller())) is None


def test_a_plan_that_is_not_finite_is_told_as_step_by_step():
    class Breaks(Called):
        def step(self, t, x, now=None):
            given = super().step(t, x, now)
            if t > 0.2:
                given.u_plan[3, 2] = np.nan
            return given

        native = Called.native

    with pytest.raises(FlightError, match=r"Breaks.step at t = 0.225 s: returned nan among"):
        fly(scenario("paper"), Breaks(Controller()), 1.0)


def test_a_state_that_is_refused_is_told_as_step_by_step():
    class Tires(Called):
        def step(self, t, x, now=None):
            if t > 0.2:
                raise ValueError("no more")
            return super().step(t, x, now)

        native = Called.native

    flies = Tires(Controller())
    with pytest.raises(ValueError, match="no more"):
        fly(scenario("paper"), flies, 1.0)
    assert flies.calls == 10
