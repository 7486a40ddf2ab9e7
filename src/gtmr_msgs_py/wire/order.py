# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The order of stamps: what comes next, what comes late, and what is another flight.

The one place that decides it, for nodes and readers of bags alike; it needs no ROS.
"""

RESET_NS = 500_000_000
"""A stamp further behind the newest than this belongs to a world that began again [ns]; what is
less far behind came late. No network holds a message back for so long."""


def is_reset(stamp_ns: int, newest_ns: int) -> bool:
    """Tell a world that began again from a message that came late, by the newest stamp before.

    A stamp is of another world if it is more than `RESET_NS` behind, or back at time zero: there a
    simulated world begins and waits to be answered, even if it was reset at once; a real clock
    never says so.
    """
    return newest_ns - stamp_ns > RESET_NS or stamp_ns == 0 < newest_ns


class StampOrder:
    """The stamps of one stream of messages, as they come."""

    def __init__(self) -> None:
        self.newest_ns: int | None = None
        """The newest stamp since the last reset [ns]."""
        self.late = 0
        """How many came behind the newest, without a reset."""

    def resets(self, stamp_ns: int) -> bool:
        """Whether a stamp [ns] would begin another flight."""
        return self.newest_ns is not None and is_reset(stamp_ns, self.newest_ns)

    def is_late(self, stamp_ns: int) -> bool:
        """Take in a stamp [ns]; one that comes again is not late, as what waits repeats itself."""
        if self.newest_ns is None or stamp_ns >= self.newest_ns or self.resets(stamp_ns):
            self.newest_ns = stamp_ns
            return False
        self.late += 1
        return True
