# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is next, late, of another flight or of an impossible future, by the stamps alone."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gtmr_msgs_py.wire.drops import WARNING_PERIOD_S, Drops
from gtmr_msgs_py.wire.message_error import CAUSES, MessageError
from gtmr_msgs_py.wire.order import END_NS, FUTURE_NS, LASTING, RESET_NS, Place, StampOrder, places

TICK_NS = 5_000_000
NEWEST_NS = 100_000_000_000
NEXT, RESET, LATE, PAST, FUTURE = Place


def placed(*stamps_ns):
    order = StampOrder()
    return [order.place(stamp_ns) for stamp_ns in stamps_ns]


def after(stamp_ns, count):
    return [stamp_ns + k * TICK_NS for k in range(count)]


@given(st.lists(st.integers(0, FUTURE_NS), max_size=20))
def test_what_follows_or_repeats_itself_is_next(steps_ns):
    stamps_ns = [sum(steps_ns[:k]) for k in range(len(steps_ns) + 1)]
    assert set(placed(*stamps_ns)) == {NEXT}


@pytest.mark.parametrize("behind_ns", [1, TICK_NS, RESET_NS])
def test_what_comes_behind_the_newest_is_late_however_often(behind_ns):
    late = [NEWEST_NS - behind_ns] * 5
    assert placed(NEWEST_NS, *late, NEWEST_NS + TICK_NS) == [NEXT, *[LATE] * 5, NEXT]


@pytest.mark.parametrize("stray_ns", [0, NEWEST_NS - RESET_NS - 1, NEWEST_NS // 2])
def test_one_stray_message_of_the_past_is_no_reset(stray_ns):
    stamps_ns = (NEWEST_NS, *[stray_ns] * (LASTING - 1), NEWEST_NS + TICK_NS)
    assert placed(*stamps_ns) == [NEXT, *[PAST] * (LASTING - 1), NEXT]


@pytest.mark.parametrize("stray_ns", [NEWEST_NS + FUTURE_NS + 1, 2 * NEWEST_NS, END_NS])
def test_a_stray_message_of_the_future_does_not_make_the_present_look_late(stray_ns):
    order = StampOrder()
    came = (NEWEST_NS, stray_ns, *after(NEWEST_NS + TICK_NS, 3))
    assert [order.place(ns) for ns in came] == [NEXT, FUTURE, NEXT, NEXT, NEXT]
    assert order.newest_ns == NEWEST_NS + 3 * TICK_NS


def test_the_end_of_time_is_never_believed_even_as_the_first():
    assert set(placed(*[END_NS + 1] * 10)) == {FUTURE}
    assert placed(END_NS + 1, 0) == [FUTURE, NEXT]


@pytest.mark.parametrize("start_ns", [0, NEWEST_NS // 2, NEWEST_NS - RESET_NS - 1])
def test_a_jump_back_that_lasts_is_one_reset(start_ns):
    there = after(start_ns, LASTING + 2)
    assert placed(NEWEST_NS, *there) == [NEXT, *[PAST] * (LASTING - 1), RESET, NEXT, NEXT]
    assert places([NEWEST_NS, *there]) == [NEXT, RESET, *[NEXT] * (LASTING + 1)]


def test_a_world_that_was_reset_at_once_and_waits_at_time_zero_is_believed():
    assert placed(0, TICK_NS, *[0] * LASTING)[-1] is RESET
    assert placed(0, TICK_NS, *[0] * (LASTING - 1), 2 * TICK_NS)[-1] is NEXT


def test_messages_that_go_on_after_a_long_silence_are_believed():
    there = after(NEWEST_NS + 60 * FUTURE_NS, LASTING + 1)
    assert placed(NEWEST_NS, *there) == [NEXT, *[FUTURE] * (LASTING - 1), NEXT, NEXT]
    assert places([NEWEST_NS, *there]) == [NEXT] * (LASTING + 2)


@given(st.lists(st.integers(-(10**9), 2**31 * 10**9), max_size=40))
def test_no_stamps_end_it_and_what_follows_is_soon_next(stamps_ns):
    order = StampOrder()
    for stamp_ns in stamps_ns:
        order.place(stamp_ns)
    assert [order.place(ns) for ns in after(NEWEST_NS, 6)][-2:] == [NEXT, NEXT]


def test_what_is_not_next_is_refused_with_its_cause():
    order = StampOrder()
    assert order.admit(NEWEST_NS) is False
    with pytest.raises(MessageError, match=r"99\.9 s, the newest 100\.0 s") as late:
        order.admit(NEWEST_NS - 100_000_000)
    with pytest.raises(MessageError) as future:
        order.admit(2 * NEWEST_NS)
    assert (late.value.cause, future.value.cause) == ("late", "future")


def test_drops_are_counted_by_cause_and_told_at_a_limited_rate():
    told, now_s = [], [0.0]
    drops = Drops(told.append, lambda: now_s[0])
    for _ in range(1000):
        drops.add(MessageError("odd", "frame"))
    drops.add(MessageError("torn"))
    assert told == ["dropped (frame, 1 so far): odd", "dropped (undecodable, 1 so far): torn"]
    now_s[0] = WARNING_PERIOD_S
    drops.add(MessageError("odd", "frame"))
    assert told[2:] == ["dropped (frame, 1001 so far): odd"]
    counts = dict.fromkeys(CAUSES, 0) | {"frame": 1001, "undecodable": 1}
    assert drops.figures() == {f"dropped_{cause}": n for cause, n in counts.items()}
