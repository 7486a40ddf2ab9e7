# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The QP by guesses of what is at the rotors' bounds, against the same QP by its rows alone."""

import numpy as np
import pytest
from support.hard_flights import random_starts
from support.rows_alone import without_guesses

from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.config import Weights
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_study.solvers.situations import in_flight, record_situations

MODES = (("nominal", "frozen"), ("robust", "frozen"), ("robust", "gradient"))
STEPS_A_START = 40
"""Steps of a recovery, the first a cold start."""


@pytest.fixture(scope="module")
def recoveries():
    """Starts from too close, too fast, rotors far apart, 4 steps each."""
    steps = record_situations(2000)[2].steps
    return [step for k in range(0, 2000, STEPS_A_START) for step in steps[k : k + 4]]


def flown(config, mode, steps):
    """Fly along states: plans, and how many guesses each step took."""
    made = CompiledIteration(config)
    controller = Controller(config, mode, made)
    last, plans, guesses = np.inf, [], []
    for t, x in steps:
        if t < last:
            controller.reset()
        last = t
        plans.append(controller.step(t, x))
        guesses.append(made.guesses)
    return plans, guesses


@pytest.mark.parametrize(("mode", "tightening"), MODES)
def test_a_few_guesses_solve_what_has_a_hundred_active_rows(recoveries, mode, tightening):
    plans, guesses = flown(ControllerConfig(tightening=tightening), mode, recoveries)
    assert {plan.status for plan in plans} <= {"solved", "softened"}
    assert min(guesses) >= 0
    assert 5 <= max(guesses) <= 9
    # A warm start knows already what is at its bounds.
    cold = np.arange(len(guesses)) % 4 == 0
    assert np.mean(np.array(guesses)[~cold]) < np.mean(np.array(guesses)[cold]) - 0.5


@pytest.mark.parametrize(("mode", "tightening"), MODES)
def test_they_find_what_the_rows_alone_find(recoveries, mode, tightening):
    config = ControllerConfig(tightening=tightening)
    with without_guesses():
        by_rows, none = flown(config, mode, recoveries)
    by_guesses, guesses = flown(config, mode, recoveries)
    assert set(none) <= {0, -1}
    assert sum(count > 0 for count in guesses) > 100
    for one, other in zip(by_rows, by_guesses, strict=True):
        assert one.status == other.status
        np.testing.assert_allclose(one.u_plan, other.u_plan, atol=1e-6)
        np.testing.assert_allclose(one.slack, other.slack, atol=1e-8)


@pytest.mark.parametrize(
    ("mode", "tightening", "start"),
    [("nominal", "frozen", 502), ("robust", "frozen", 160), ("robust", "gradient", 160)],
)
def test_a_clearance_that_did_not_count_at_first_is_kept(mode, tightening, start):
    """On the fourth step, one that all guesses but the last keep."""
    config = ControllerConfig(tightening=tightening)
    x = random_starts(config, start + 1)[-1]
    with without_guesses():
        controller = Controller(config, mode, CompiledIteration(config))
        states, by_rows = [x], []
        for k in range(4):
            by_rows.append(controller.step(0.025 * k, states[-1]))
            states.append(by_rows[-1].x_plan[1])
    steps = [(0.025 * k, state) for k, state in enumerate(states[:4])]
    by_guesses, guesses = flown(config, mode, steps)
    assert guesses[-1] > 0
    for one, other in zip(by_rows, by_guesses, strict=True):
        assert one.status == other.status
        np.testing.assert_allclose(one.u_plan, other.u_plan, atol=1e-6)
        np.testing.assert_allclose(one.slack, other.slack, atol=1e-8)


class AtEveryStage:
    """A margin that leaves no room but a hair, and at one stage takes some more."""

    def __init__(self, room_m):
        self.alpha_m = room_m - 1e-6
        self.alpha_m[8] += 0.002

    def tightening(self, _):
        return self.alpha_m


def test_a_clearance_that_another_one_breaks_is_kept():
    """No limit of a rotor matters. Who is pushed out at one stage swings back further in."""
    light = (0.01, 0.01, 0.01)
    swinging = {"position": (5e3, 5e3, 5e3), "velocity": light, "acceleration": light}
    config = ControllerConfig(weights=Weights(**swinging, rotor_acceleration=1e-5))
    x = config.helix.initial_state(config.tower, config.vehicle)
    free = Controller(config, "nominal").step(0.0, x)
    outwards = x[:2] / np.hypot(*x[:2])
    room_m = -config.tower.residual(x) + (free.x_plan[:, :2] - x[:2]) @ outwards
    margin = AtEveryStage(room_m)
    made, other = CompiledIteration(config), InterpretedIteration(config)
    plan = Controller(config, "robust", made, margin=margin).step(0.0, x)
    expected = Controller(config, "robust", other, margin=margin).step(0.0, x)
    assert made.guesses == 0
    assert plan.status == expected.status
    assert np.abs(expected.u_plan - free.u_plan).max() > 1.0
    np.testing.assert_allclose(plan.u_plan, expected.u_plan, atol=1e-6)
    np.testing.assert_allclose(plan.slack, expected.slack, atol=1e-9)


def test_a_flight_at_the_constraint_needs_none():
    config = ControllerConfig()
    made = CompiledIteration(config)
    controller = Controller(config, "robust", made)
    status = set()
    for t, x in in_flight(record_situations(200)[1], controller.reset):
        status.add(controller.step(t, x).status)
        assert made.guesses == 0
    assert status == {"solved"}


def test_one_preparation_is_good_for_several_states(recoveries):
    """Feedback leaves what preparation found as it was."""
    config = ControllerConfig()
    hover = config.helix.initial_state(config.tower, config.vehicle)
    once, again = CompiledIteration(config), CompiledIteration(config)
    mild = hover - np.r_[0.2, np.zeros(17)]
    for _, hard in recoveries[::40]:
        for made in (once, again):
            made.cold(hover)
            made.prepare(0.0, 0.0)
        assert again.feedback(hard).status != "failed"
        assert again.guesses > 1
        first, second = once.feedback(mild), again.feedback(mild)
        assert again.guesses > 0
        np.testing.assert_allclose(second.u_plan, first.u_plan, atol=1e-6)
