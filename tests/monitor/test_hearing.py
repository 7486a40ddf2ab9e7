# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a monitor did not hear is counted, and nothing else is."""

import pytest

from gtmr_monitor.hearing import Gaps, Numbers

PERIOD_NS = 25_000_000


def heard(numbers):
    gaps = Gaps()
    ends = [k for k in numbers if gaps.take(k * PERIOD_NS)]
    return gaps, ends


def test_steady_odometry_has_no_gap():
    assert heard(range(100))[0].count == 0


def test_a_gap_is_counted_with_its_length():
    gaps, ends = heard([k for k in range(100) if not 40 <= k < 50])

    assert ends == [50]
    assert (gaps.count, gaps.missing_s) == (1, pytest.approx(0.275))


def test_a_single_odometry_that_is_missing_is_a_gap():
    assert heard([k for k in range(100) if k != 40])[0].count == 1


def test_what_waits_and_repeats_itself_is_no_gap():
    assert heard([0] * 30 + list(range(50)) + [49] * 30 + list(range(50, 100)))[0].count == 0


def test_numbers_that_are_left_out_are_messages_that_were_lost():
    numbers = Numbers()
    for number in (7, 8, 12, 13):
        numbers.take("/odom", number)
    numbers.take("/clock", 1)

    assert numbers.lost == {"/odom": 3}


def test_a_publisher_that_was_started_again_has_lost_nothing():
    numbers = Numbers()
    for number in (100, 101, 1, 2, None):
        numbers.take("/odom", number)

    assert not numbers.lost
