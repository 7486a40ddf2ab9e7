# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The QP by guesses of what is at the rotors' bounds, against the same QP by its rows alone."""

from contextlib import contextmanager

import numpy as np
import pytest

from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.compiled import codegen, iteration
from gtmr_nmpc.compiled.iteration import CompiledIteration
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


@contextmanager
def without_guesses():
    """Make controllers that leave every QP to its rows."""
    iteration._library.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(codegen, "WRITTEN_FLAGS", ("-O1", "-DGTMR_MAX_GUESSES=0"))
        patch.setattr(codegen, "GENERATED_FLAGS", ("-O1",))
        yield
    iteration._library.cache_clear()


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
