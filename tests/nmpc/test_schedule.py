# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Controller steps come T_s apart, by the stamps of the odometry."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_msgs_py.wire.order import StampOrder
from gtmr_nmpc.online.schedule import Due, Schedule

PERIOD_NS = 25_000_000
TICK_NS = 5_000_000


def admitted(schedule, stamps_ns):
    return [schedule.admit(stamp) for stamp in stamps_ns]


def test_faster_odometry_is_thinned_out_to_the_sampling_time():
    due = admitted(Schedule(PERIOD_NS), range(0, 10 * PERIOD_NS, TICK_NS))
    assert due[::5] == [Due.RESTART] + 9 * [Due.STEP]
    assert due.count(Due.NOTHING) == len(due) - 10


@given(st.lists(st.integers(-TICK_NS // 4, TICK_NS // 4), min_size=50, max_size=50))
def test_uneven_odometry_keeps_the_instants_that_were_prepared_for(jitter_ns):
    schedule, planned = Schedule(PERIOD_NS), []
    for k, late in enumerate([0, *jitter_ns]):
        if schedule.admit(k * TICK_NS + late) is not Due.NOTHING:
            planned.append(schedule.time_ns)
    assert planned == [k * PERIOD_NS for k in range(11)]


def test_a_late_odometry_starts_a_new_grid_and_its_gap_is_counted():
    schedule = Schedule(PERIOD_NS)
    late = 3 * PERIOD_NS + TICK_NS
    assert admitted(schedule, [0, late]) == [Due.RESTART, Due.STEP]
    assert schedule.time_ns == late
    assert schedule.next_ns == late + PERIOD_NS
    assert schedule.skipped == 2


@pytest.mark.parametrize("stamp_ns", [0, 7 * PERIOD_NS])
def test_an_odometry_that_comes_again_is_answered_again(stamp_ns):
    schedule = Schedule(PERIOD_NS)
    assert admitted(schedule, [stamp_ns, stamp_ns]) == [Due.RESTART, Due.REPEAT]
    assert schedule.time_ns == stamp_ns


def test_a_world_that_begins_again_starts_anew():
    schedule = Schedule(PERIOD_NS)
    due = admitted(schedule, [0, PERIOD_NS, 2 * PERIOD_NS])
    due += [schedule.admit(0, begins_again=True), schedule.admit(PERIOD_NS)]
    assert due == [Due.RESTART, Due.STEP, Due.STEP, Due.RESTART, Due.STEP]
    assert schedule.admit(0, begins_again=True) is Due.RESTART


def test_reordered_odometry_starts_the_controller_once():
    # As a node does: what comes late is left out before the schedule is asked.
    rng, starts = np.random.default_rng(1), []
    for _ in range(64):
        came = np.argsort(np.arange(3000) + rng.uniform(0.0, 40.0) * rng.random(3000))
        order, schedule, due = StampOrder(), Schedule(PERIOD_NS), []
        for k in came:
            with suppress(MessageError):
                begins_again = order.admit(int(k) * TICK_NS)
                due.append(schedule.admit(int(k) * TICK_NS, begins_again))
        starts.append(due.count(Due.RESTART))
    assert starts == [1] * 64
