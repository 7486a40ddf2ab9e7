# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Time in messages: whole nanoseconds, so that nothing drifts, and seconds for the equations."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from builtin_interfaces.msg import Duration, Time

NANOSECONDS = 1_000_000_000
"""In a second."""


def nanoseconds(time_s: float) -> int:
    """Round seconds to whole nanoseconds."""
    return round(time_s * NANOSECONDS)


def seconds(time_ns: int) -> float:
    """Give the float [s] nearest to a number of nanoseconds."""
    return time_ns / NANOSECONDS


def encode(time_ns: int) -> Time:
    """Make a stamp of a time [ns] that is not negative."""
    # Here alone is ROS needed: what reads stamps works without.
    from builtin_interfaces.msg import Time

    sec, nanosec = divmod(int(time_ns), NANOSECONDS)
    return Time(sec=sec, nanosec=nanosec)


def decode(stamp: Time | Duration) -> int:
    """Read a stamp or a duration [ns]."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)
