# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A controller of one's own needs step(t, x) and no more; what it does not tell is no number."""

from types import SimpleNamespace

import numpy as np
import pytest

from gtmr_nmpc import Controller
from gtmr_sim import FlightError, Scenario, World, fly

PERIOD_S = 0.025


class Gives:
    """Returns what a function makes of the step's time."""

    def __init__(self, function):
        self.function = function

    def step(self, t, x):
        x[:] = np.nan  # its own copy
        return self.function(t)


def test_rotor_accelerations_are_enough_and_nothing_else_is_made_up():
    log = fly(Scenario(), Gives(lambda t: [10.0 * t] * 6), 0.1)

    np.testing.assert_allclose(log.u, np.outer(10.0 * log.t, np.ones(6)))
    np.testing.assert_allclose(log.x[1:, 12], log.x[0, 12] + PERIOD_S * np.cumsum(log.u[:-1, 0]))
    assert log.alpha_p.shape == log.alpha_g.shape == log.slack.shape == (4, 0)
    assert log.max_slack_m is None
    assert log.failed_steps is None
    assert (log.solve_ms > 0.0).all()


def test_what_it_does_tell_is_kept():
    def plan(t):
        timing = SimpleNamespace(total_s=0.5)
        return SimpleNamespace(u_plan=np.ones((2, 6)), slack=[t], status="failed", timing=timing)

    log = fly(Scenario(), Gives(plan), 0.1)

    np.testing.assert_array_equal(log.slack[:, 0], log.t)
    assert log.max_slack_m == log.t[-1]
    assert log.failed_steps == 4
    assert (log.solve_ms == 500.0).all()
    assert log.alpha_p.shape == (4, 0)


def test_arrays_that_a_controller_uses_again_are_kept_as_they_were():
    u = np.zeros(6)

    def counts(_):
        nonlocal u
        u += 1.0
        return u

    np.testing.assert_array_equal(fly(Scenario(), Gives(counts), 0.1).u[:, 0], [1, 2, 3, 4])


def test_the_suites_controller_by_its_array_alone_flies_the_same():
    controller = Controller()
    whole = fly(Scenario(seed=2), controller, 1.0)
    controller.reset()

    class First:
        step = staticmethod(lambda t, x: controller.step(t, x).u)

    assert fly(Scenario(seed=2), First(), 1.0).x.tobytes() == whole.x.tobytes()


@pytest.mark.parametrize(
    ("result", "told"),
    [
        (np.zeros(5), r"shape \(5,\), expected \(6,\)"),
        (np.full(6, np.nan), "nan among the rotor accelerations"),
        (None, r"shape \(\)"),
        ("up", "float"),
        (SimpleNamespace(u_plan=np.zeros(6)), r"u_plan has shape \(6,\), expected \(n, 6\)"),
        (SimpleNamespace(u_plan=np.zeros((0, 6))), "u_plan has shape"),
    ],
)
def test_what_cannot_be_flown_is_told_with_the_controller_and_the_time(result, told):
    controller = Gives(lambda t: result if t > 0.01 else np.zeros(6))
    with pytest.raises(FlightError, match=rf"Gives.step at t = 0.025 s: .*{told}"):
        fly(Scenario(), controller, 0.1)


def test_a_controller_that_tells_its_slack_now_and_then_is_refused():
    def now_and_then(t):
        return SimpleNamespace(u_plan=np.zeros((1, 6)), slack=[0.0] * (t > 0.01))

    with pytest.raises(FlightError, match="in its first step"):
        fly(Scenario(), Gives(now_and_then), 0.1)


class Faster:
    """Asks all rotors for the same acceleration, and is not told when it acts."""

    def step(self, t, x):
        return np.full(6, 4.0)


def test_accelerations_alone_act_in_a_world_whose_odometry_is_late():
    scenario = Scenario(gust={"kind": "none"}, world=World.preset("world", "field"), guard="hold")
    log = fly(scenario, Faster(), 1.0)
    gained_hz = log.x[-1, 12:] - log.x[0, 12:]
    # 4 Hz/s over a second, less what comes late: the odometry, and the motors.
    assert ((gained_hz > 3.6) & (gained_hz < 4.0)).all()
