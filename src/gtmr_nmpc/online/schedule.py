# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""When a controller step is due, by the stamps of the odometry rather than by any clock."""

from enum import Enum, auto


class Due(Enum):
    """What an odometry asks for."""

    STEP = auto()
    """The next step."""
    RESTART = auto()
    """A first step: the world began again, or there was none yet."""
    REPEAT = auto()
    """The last command again: this odometry has been answered, but the answer was lost."""
    NOTHING = auto()
    """To wait: the next step is not due yet."""


class Schedule:
    """Steps T_s (period_ns) apart, on odometry that may come faster and a little unevenly."""

    EVENNESS = 10
    """An odometry within T_s / 10 of the instant that was prepared for is taken as that instant,
    so that an uneven estimator does not waste the preparation."""
    SELDOM = 0.6
    """An odometry this share of T_s or more after the last one, if that was answered, is a step:
    it comes at the controller's own rate, but for the jitter of its delay."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.time_ns = 0
        """The instant to plan from [ns]."""
        self.skipped = 0
        """How many steps had no odometry, or came too late."""
        self._answered_ns: int | None = None
        self._heard_ns = 0

    @property
    def next_ns(self) -> int:
        """The instant to prepare for [ns]."""
        return self.time_ns + self.period_ns

    def admit(self, stamp_ns: int, begins_again: bool = False) -> Due:
        """Say what an odometry asks for by its stamp [ns], and move on if it is a step.

        Those that come late are left out before; `StampOrder` says so, and when the world begins
        again.
        """
        tolerance_ns = self.period_ns // self.EVENNESS
        before_ns, self._heard_ns = self._heard_ns, stamp_ns
        since_ns = stamp_ns - before_ns
        is_seldom = before_ns == self._answered_ns and since_ns >= self.SELDOM * self.period_ns
        if begins_again or self._answered_ns is None:
            self.time_ns, due = stamp_ns, Due.RESTART
        elif stamp_ns == self._answered_ns:
            return Due.REPEAT
        elif stamp_ns < self.next_ns - tolerance_ns and not is_seldom:
            return Due.NOTHING
        else:
            late_ns = stamp_ns - self.next_ns
            self.skipped += max(0, late_ns) // self.period_ns
            self.time_ns = self.next_ns if abs(late_ns) <= tolerance_ns else stamp_ns
            due = Due.STEP
        self._answered_ns = stamp_ns
        return due
