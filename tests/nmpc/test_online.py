# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Which measurements the node believes, how late they may be, and which plans it sends."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from gtmr_model import Helix, Tower, Vehicle
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_nmpc import Controller
from gtmr_nmpc.online.delay import Delay
from gtmr_nmpc.online.fitness import FAILING_S, MAX_SPEED_M_S, Fitness
from gtmr_nmpc.online.plausibility import LASTING, LASTING_NS, Plausibility
from gtmr_sim import Scenario, fly

VEHICLE = Vehicle.paper()
START = Helix().initial_state(Tower(), VEHICLE)
PERIOD_NS = 25_000_000
TICK_NS = 5_000_000


def moved(index, by):
    x = START[:12].copy()
    x[index] += by
    return x


def refuses(plausibility, stamp_ns, x):
    try:
        plausibility.check(stamp_ns, x)
    except MessageError as error:
        return error.cause == "jump"
    return False


@pytest.mark.parametrize(("seed", "gust"), list(product((1, 2), ("ou", "worst-case"))))
def test_nothing_that_a_vehicle_flies_is_taken_for_a_jump_whatever_is_lost(seed, gust):
    scenario = Scenario(seed=seed, gust={"kind": gust}).sampled()
    states = fly(scenario, Controller(mode="nominal"), 4.0).x[:, :12]
    rng = np.random.default_rng(seed)
    for lost in (0.0, 0.5, 0.95):
        plausibility = Plausibility(VEHICLE)
        kept = np.flatnonzero(rng.random(len(states)) >= lost)
        assert not any(refuses(plausibility, int(k) * PERIOD_NS, states[k]) for k in kept)


def test_the_noise_of_a_poor_estimator_is_no_jump():
    rng, plausibility = np.random.default_rng(1), Plausibility(VEHICLE)
    noise = np.repeat([0.02, 0.01, 0.05, 0.03], 3)
    for k in range(2000):
        x = START[:12] + noise * rng.normal(size=12)
        x[:3] += k * TICK_NS / 1e9 * START[6:9]
        assert not refuses(plausibility, k * TICK_NS, x)


@pytest.mark.parametrize(
    ("index", "by"),
    [(0, 0.4), (2, -5.0), (6, 2.0), (3, 0.5), (5, math.pi), (9, 12.0), (1, 1e300), (7, -1e300)],
)
def test_one_odometry_that_no_vehicle_can_reach_is_set_aside(index, by):
    plausibility = Plausibility(VEHICLE)
    plausibility.check(0, START[:12])
    assert refuses(plausibility, TICK_NS, moved(index, by))
    assert not refuses(plausibility, 2 * TICK_NS, START[:12])


def test_a_whole_turn_of_yaw_is_no_jump():
    plausibility = Plausibility(VEHICLE)
    plausibility.check(0, START[:12])
    assert not refuses(plausibility, TICK_NS, moved(5, math.tau))


@pytest.mark.parametrize("period_ns", [TICK_NS, PERIOD_NS])
def test_a_jump_that_lasts_is_believed(period_ns):
    plausibility, there = Plausibility(VEHICLE), moved(0, 1.0)
    plausibility.check(0, START[:12])
    stamps_ns = range(period_ns, 10 * LASTING_NS, period_ns)
    refused = [refuses(plausibility, stamp_ns, there) for stamp_ns in stamps_ns]
    aside = max(LASTING - 1, LASTING_NS // period_ns)
    assert refused == [True] * aside + [False] * (len(refused) - aside)


def test_what_a_waiting_simulation_says_again_and_again_is_believed():
    plausibility = Plausibility(VEHICLE)
    plausibility.check(0, START[:12])
    refused = [refuses(plausibility, PERIOD_NS, moved(0, 1.0)) for _ in range(LASTING)]
    assert refused == [True] * (LASTING - 1) + [False]


def test_jumps_that_do_not_agree_never_last():
    plausibility, rng = Plausibility(VEHICLE), np.random.default_rng(1)
    plausibility.check(0, START[:12])
    for k in range(1, 40):
        assert refuses(
            plausibility, k * TICK_NS, moved(slice(0, 3), 100.0 * k * rng.normal(size=3))
        )


def test_a_world_that_began_again_may_begin_anywhere():
    plausibility = Plausibility(VEHICLE)
    plausibility.check(10**9, START[:12])
    plausibility.reset()
    assert not refuses(plausibility, 0, moved(0, 3.0))


@pytest.mark.parametrize("delay_s", [0.0, 0.035, 0.5])
def test_delay_is_measured_by_the_clock_that_the_stamps_are_of(delay_s):
    delay, system_ns, simulated_ns = Delay(), 1_790_000_000 * 10**9, 20 * 10**9
    late_ns = round(delay_s * 1e9)
    assert delay.measure(system_ns - late_ns, system_ns) == pytest.approx(delay_s)
    assert delay.measure(simulated_ns - late_ns, system_ns) is None
    delay.simulated_ns = simulated_ns
    assert delay.measure(simulated_ns - late_ns, system_ns) == pytest.approx(delay_s)
    assert delay.measure(system_ns - late_ns, system_ns) == pytest.approx(delay_s)
    assert delay.last_s == pytest.approx(delay_s)


def test_a_state_newer_than_the_simulated_time_heard_so_far_is_not_late():
    delay = Delay()
    delay.simulated_ns = 10**9
    assert delay.measure(10**9 + TICK_NS, 0) == 0.0


@pytest.fixture(scope="module")
def plan():
    return Controller().step(0.0, START)


def test_a_solver_that_fails_on_and_on_sends_no_plan(plan):
    fitness, failed = Fitness(), replace(plan, status="failed")
    times = np.arange(12) * 0.025
    reasons = [fitness.reason(t, START, failed) for t in times]
    assert [bool(reason) for reason in reasons] == list(times > FAILING_S)
    assert "solver has failed" in reasons[-1]
    assert fitness.reason(0.3, START, plan) == ""
    assert fitness.reason(0.325, START, failed) == ""


def test_a_plan_of_a_solver_that_was_stopped_is_sent(plan):
    fitness, limited = Fitness(), replace(plan, status="limited")
    assert {fitness.reason(0.025 * k, START, limited) for k in range(12)} == {""}


@pytest.mark.parametrize(
    ("index", "value", "reason"),
    [(3, 2.0, "inverted"), (4, -1.6, "inverted"), (8, -MAX_SPEED_M_S - 0.1, "faster")],
)
def test_a_vehicle_beyond_the_model_is_left_to_the_guard(plan, index, value, reason):
    x = START.copy()
    x[index] = value
    assert reason in Fitness().reason(0.0, x, plan)


def test_a_plan_of_an_ordinary_flight_is_sent(plan):
    assert Fitness().reason(0.0, START, plan) == ""
    assert "no number" in Fitness().reason(0.0, START, replace(plan, u_plan=plan.u_plan * np.nan))
