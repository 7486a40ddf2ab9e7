# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a monitor did not hear: by the numbers of messages, and by the stamps of odometry."""

from collections import Counter, deque
from statistics import median

from gtmr_monitor.coverage import GAP_PERIODS

_REMEMBERED = 41
"""So many distances of stamps tell their period."""
_ENOUGH = 5
"""From so many distances on a period is known."""


class Numbers:
    """The numbers that a publisher gives its messages, one after the other, by topic."""

    def __init__(self) -> None:
        self.lost: Counter[str] = Counter()
        """How many messages were sent but never came, by topic."""
        self._newest: dict[str, int] = {}

    def take(self, topic: str, number: int | None) -> None:
        """Take in the number of a message; None where the middleware gives none.

        One that is not above the newest is that of a publisher that was started again.
        """
        if number is None:
            return
        newest = self._newest.get(topic)
        self._newest[topic] = number
        if newest is not None and number > newest + 1:
            self.lost[topic] += number - newest - 1


class Gaps:
    """Gaps in odometry that is sent at a steady rate; the rate is learnt from what comes."""

    def __init__(self) -> None:
        self.count = 0
        """How many there were."""
        self.missing_s = 0.0
        """How long they were in all, from one odometry to the next [s]."""
        self._newest_ns: int | None = None
        self._apart_ns: deque[int] = deque(maxlen=_REMEMBERED)

    def take(self, stamp_ns: int) -> bool:
        """Take in a stamp [ns] that is not late, and tell whether it ends a gap."""
        newest_ns, self._newest_ns = self._newest_ns, stamp_ns
        # What waits repeats itself.
        if newest_ns is None or stamp_ns <= newest_ns:
            return False
        apart_ns = stamp_ns - newest_ns
        known = len(self._apart_ns) >= _ENOUGH
        is_gap = known and apart_ns > GAP_PERIODS * median(self._apart_ns)
        if is_gap:
            self.count += 1
            self.missing_s += apart_ns * 1e-9
        self._apart_ns.append(apart_ns)
        return is_gap
