# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The step in C is the one in Python around the same phases, to the last digit."""

import copy
import ctypes
import pickle
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from gtmr_nmpc import Controller, ControllerConfig, Solution
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.margins import ClosedLoopMargin, FixedMargin, Tightening
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_nmpc.solution import FIELDS
from gtmr_sim import Scenario, Simulation

CONFIG = ControllerConfig()
START = CONFIG.helix.initial_state(CONFIG.tower, CONFIG.vehicle)
PRESETS = {"paper": "default", "field": "field", "hard": "hard"}
"""The controller that is told of a world."""
TOLD = (
    *("u", "x_plan", "u_plan", "setpoints_hz", "slack", "status", "margin_scale"),
    *("alpha_p", "alpha_p_by_channel", "alpha_g", "eps_s"),
)


class InPhases(CompiledIteration):
    """Not the compiled iteration itself, so that the steps around it are those in Python."""


class OwnClosedLoop(ClosedLoopMargin):
    """A margin of the closed loop that is asked in every step."""

    kind: str = "own-closed-loop"


def both(config, mode):
    return Controller(config, mode), Controller(config, mode, InPhases(config))


def scenario_of(world, config):
    return Scenario(
        vehicle=config.vehicle,
        tower=config.tower,
        helix=config.helix,
        uncertainty=config.uncertainty,
        world=world,
        seed=3,
    ).sampled()


def eventful_flight(world, config, duration_s=20.0):
    """Measured states with losses, a gap, turned yaw, jumps and states out of this world."""
    simulation, rng = Simulation(scenario_of(world, config), 0.025), np.random.default_rng(5)
    for k in range(round(duration_s / 0.025)):
        newest = simulation.measured()
        is_lost = rng.random() < 0.05 or 300 <= k < 345
        if newest is not None and not is_lost:
            stamp_s, x = newest[0], newest[1].copy()
            if k % 50 == 7:
                x[5] += 2.0 * np.pi * rng.integers(-3, 4)
            if k % 97 == 0:
                x[:3] += rng.uniform(-0.3, 0.3, 3)
                x[3:5] += rng.uniform(-0.4, 0.4, 2)
            if k % 190 == 100:
                x[9:11] = 1e308, -1e308
            late_s = 0.013 if k % 211 == 5 else 0.0
            solution = yield k, stamp_s, x, stamp_s + config.delay_s + late_s
            simulation.command(stamp_s + config.delay_s, solution.u_plan, solution.setpoints_hz)
        simulation.advance(0.025)


def fly_both(world, config, mode, before=lambda k, controllers: None):
    """Fly with the step in C, and count how its steps end; the other must say the same."""
    controllers = both(config, mode)
    flight, ends, solution = eventful_flight(world, config), [], None
    while True:
        try:
            k, t, x, now = flight.send(solution)
        except StopIteration:
            return ends
        before(k, controllers)
        if k % 2:
            for controller in controllers:
                controller.prepare(now)
        solution, expected = (controller.step(t, x, now) for controller in controllers)
        for name in TOLD:
            np.testing.assert_array_equal(
                getattr(solution, name), getattr(expected, name), f"{name} in step {k}"
            )
        ends.append(solution.status)


@pytest.mark.slow
@pytest.mark.parametrize("world", PRESETS)
@pytest.mark.parametrize("mode", ["nominal", "robust", "offset_free"])
def test_a_flight_is_the_same_to_the_last_digit(world, mode):
    config = ControllerConfig.load("controller", PRESETS[world])
    ends = fly_both(world, config, mode)
    assert len(ends) > 600
    assert ends.count("failed") >= 3


@pytest.mark.slow
@pytest.mark.parametrize("margin", [FixedMargin(), None])
@pytest.mark.parametrize("tightening", ["frozen", "gradient"])
def test_switches_margins_of_ones_own_and_resets_are_the_same_too(margin, tightening):
    if margin is not None and tightening == "gradient":
        margin_of = {"offset_free": {"margin": OwnClosedLoop()}}
    else:
        margin_of = {} if margin is None else {"margin": margin}
    config = ControllerConfig.load("controller", "field")
    config = config.model_copy(update={"tightening": tightening})
    config = ControllerConfig.model_validate(config.model_dump() | margin_of)
    modes = ["robust", "offset_free", "nominal", "offset_free", "robust"]

    def switch(k, controllers):
        for controller in controllers:
            if k % 60 == 30:
                controller.mode = modes[k // 60 % 5]
            if k == 200:
                controller.reset()
            if k == 400:
                controller.reconfigure(config.model_copy(update={"eps_s_m": 0.02}))

    fly_both("field", config, "nominal", switch)


def native_step(controller):
    native = controller.native()
    step = ctypes.CFUNCTYPE(
        ctypes.c_int,
        ctypes.c_void_p,
        ctypes.c_double,
        ctypes.c_void_p,
        ctypes.c_double,
        ctypes.c_void_p,
    )(native.function)

    def call(t, x, now):
        plan = np.full(native.plan_length, np.nan)
        status = step(native.memory, t, x.ctypes.data, now, plan.ctypes.data)
        told = {
            name: plan[start : start + int(np.prod(shape))].reshape(shape)
            for name, (start, shape) in native.parts.items()
        }
        return native.statuses[status] if status >= 0 else status, told

    return call


@pytest.mark.parametrize("mode", ["nominal", "robust", "offset_free"])
def test_steps_of_a_loop_in_c_and_of_python_mix(mode):
    config = ControllerConfig.load("controller", "field")
    mixed, plain = Controller(config, mode), Controller(config, mode)
    flight, solution = eventful_flight("field", config, 3.0), None
    for _ in range(60):
        k, t, x, now = flight.send(solution)
        solution = plain.step(t, x, now)
        if k % 3:
            status, told = native_step(mixed)(t, x, now)
            assert status == solution.status
            for name, value in told.items():
                np.testing.assert_array_equal(value, getattr(solution, name), name)
        else:
            np.testing.assert_array_equal(mixed.step(t, x, now).u_plan, solution.u_plan)


def test_a_loop_in_c_is_refused_what_python_is_refused():
    step = native_step(Controller(CONFIG))
    assert step(0.0, START * np.nan, 0.0)[0] < 0
    assert step(0.0, START, -0.1)[0] < 0
    assert step(0.0, START, np.inf)[0] < 0
    assert step(0.0, START, 0.0)[0] == "solved"
    for now in (-0.1, np.inf, np.nan):
        with pytest.raises(ValueError, match="now = "):
            Controller(CONFIG).step(0.0, START, now)


def test_what_needs_python_in_every_step_is_not_native():
    assert Controller(CONFIG, iteration=InterpretedIteration(CONFIG)).native() is None
    own = ControllerConfig(margin=FixedMargin())
    assert Controller(own, "robust").native() is None
    assert Controller(own, "nominal").native() is not None
    another = ControllerConfig(offset_free={"margin": {"kind": "own-closed-loop"}})
    assert Controller(another, "offset_free").native() is None


def test_a_controller_is_native_again_after_a_switch():
    controller, twin = Controller(CONFIG, "nominal"), Controller(CONFIG, "nominal")
    for each in (controller, twin):
        each.step(0.0, START)
        each.mode = "robust"
    for k in range(1, 41):
        assert controller.native() is None
        controller.step(0.025 * k, START)
        twin.step(0.025 * k, START)
    _, told = native_step(controller)(1.025, START, 1.025)
    np.testing.assert_array_equal(told["alpha_p"], twin.step(1.025, START).alpha_p)


def test_a_solution_is_whole_however_it_is_copied():
    controller = Controller(CONFIG, "offset_free")
    controller.step(0.0, START)
    solution = controller.step(0.025, START)
    kept = pickle.loads(pickle.dumps(solution))
    deep = copy.deepcopy(solution)
    controller.step(0.05, START + 0.01)
    plain = Solution(**{name: getattr(solution, name) for name in FIELDS})
    for other in (kept, deep, replace(solution, status="limited")):
        np.testing.assert_array_equal(other.x_plan, plain.x_plan)
        np.testing.assert_array_equal(other.alpha_p, plain.alpha_p)
        assert other.timing == plain.timing
    assert 0.0 < solution.timing.feedback_s < solution.timing.total_s < 1.0
    assert isinstance(solution.tightening, Tightening)
    assert solution.x_plan is solution.x_plan


def test_a_solution_has_its_fields_alone_and_keeps_them():
    solution = Controller(CONFIG).step(0.0, START)
    with pytest.raises(AttributeError, match="'Solution' object has no attribute 'plan'"):
        _ = solution.plan
    with pytest.raises(FrozenInstanceError):
        solution.u_plan = None


def test_what_comes_between_a_controller_and_its_step_is_not_passed_over():
    class Between(Controller):
        def feedback(self, t, x, now=None):
            return super().feedback(t, x, now)

    replaced = Controller()
    replaced.feedback = lambda t, x, now=None: None

    assert Controller().native() is not None
    assert Between().native() is None
    assert replaced.native() is None
