# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a node does not use, counted by cause and told at a limited rate; it needs no ROS."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable

from gtmr_msgs_py.wire.message_error import CAUSES, Cause, MessageError

WARNING_PERIOD_S = 5.0
"""Least time between two warnings about the same cause [s]."""


class Drops:
    """Counts dropped messages; ``warn`` is told of them in one line, the first of a cause at once.

    ``clock`` gives a time [s] that does not go back.
    """

    def __init__(
        self, warn: Callable[[str], object], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.counts: Counter[Cause] = Counter()
        """How many were dropped, by cause."""
        self._warn, self._clock = warn, clock
        self._warned_s: dict[Cause, float] = {}

    def add(self, error: MessageError) -> None:
        """Count a message that could not be used."""
        cause, now_s = error.cause, self._clock()
        self.counts[cause] += 1
        last_s = self._warned_s.get(cause)
        if last_s is None or now_s - last_s >= WARNING_PERIOD_S:
            self._warned_s[cause] = now_s
            self._warn(f"dropped ({cause}, {self.counts[cause]} so far): {error}")

    def figures(self) -> dict[str, int]:
        """Give the counts as diagnostics have them, ``dropped_<cause>``, every cause."""
        return {f"dropped_{cause}": self.counts[cause] for cause in CAUSES}
