# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How late odometry comes, by the clock that its stamps are of."""

from __future__ import annotations

SAME_CLOCK_NS = 3600 * 1_000_000_000
"""Stamps further than this from a clock are of another one [ns]: that of a simulation begins at
zero, that of a computer in 1970."""


class Delay:
    """Measures the delay of odometry against simulated time, or else the computer's.

    Simulated time is what was last heard of it: that of the newest state, or of the one before,
    so that a delay is measured up to one tick short, never long. Where a simulation waits for a
    command, in lockstep and as fast as possible, it is zero. Where neither clock is that of the
    stamps, the delay is not known.
    """

    def __init__(self) -> None:
        self.simulated_ns: int | None = None
        """The newest simulated time, if any was heard [ns]."""
        self.last_s: float | None = None
        """What was last measured, None for not known [s]."""

    def measure(self, stamp_ns: int, system_ns: int) -> float | None:
        """Give the delay [s] of a stamp at the computer's time, both [ns]; None for not known."""
        self.last_s = None
        for now_ns in (self.simulated_ns, system_ns):
            if now_ns is not None and abs(now_ns - stamp_ns) < SAME_CLOCK_NS:
                self.last_s = max(0, now_ns - stamp_ns) / 1e9
                break
        return self.last_s
