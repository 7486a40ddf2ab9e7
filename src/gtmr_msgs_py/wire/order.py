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

from collections.abc import Iterable
from enum import Enum, auto

from gtmr_msgs_py.wire.message_error import Cause, MessageError
from gtmr_msgs_py.wire.stamps import seconds

RESET_NS = 500_000_000
"""A stamp further behind the newest than this belongs to a world that began again [ns]; what is
less far behind came late. No network holds a message back for so long."""
FUTURE_NS = 1_000_000_000
"""A stamp further ahead of the newest than this is doubted [ns]: messages may have been lost, or
it is of an impossible future."""
LASTING = 3
"""A jump of the stamps, ahead or back, is believed when so many messages in a row bear it out; one
stray message is no other flight."""
END_NS = (2**31 - 3600) * 1_000_000_000
"""What is later is never believed [ns]: stamps end an hour later, and a plan would go beyond."""


class Place(Enum):
    """Where a stamp stands in its stream."""

    NEXT = auto()
    """It follows the newest, or repeats it, as what waits repeats itself."""
    RESET = auto()
    """It begins another flight: a jump back has lasted."""
    LATE = auto()
    """It came behind the newest."""
    PAST = auto()
    """So far behind the newest that it is of another flight, if that lasts."""
    FUTURE = auto()
    """Impossibly far ahead of the newest, unless that lasts."""


def is_reset(stamp_ns: int, newest_ns: int) -> bool:
    """Tell whether a stamp is of a world that began again, rather than late, if that lasts.

    It is more than `RESET_NS` behind the newest, or back at time zero: there a simulated world
    begins and waits to be answered, even if it was reset at once; a real clock never says so.
    """
    return newest_ns - stamp_ns > RESET_NS or stamp_ns == 0 < newest_ns


class StampOrder:
    """The stamps of one stream of messages, as they come.

    What jumps, back as `is_reset` says or ahead, is set aside until `LASTING` messages in a row
    agree, each at most `FUTURE_NS` after the one before; the last is then next, or a reset.
    """

    def __init__(self) -> None:
        self.newest_ns: int | None = None
        """The newest stamp since the last reset [ns]."""
        self._aside_ns: int | None = None
        self._asides = 0
        self._is_far_behind = False
        self.borne_out = 0
        """How many messages, set aside just before, the last one has shown to be right."""

    def place(self, stamp_ns: int) -> Place:
        """Take in a stamp [ns], and say where it stands."""
        place, self.borne_out = self._place(stamp_ns), 0
        if place in (Place.PAST, Place.FUTURE):
            self._asides = self._asides + 1 if self._follows(stamp_ns) else 1
            self._aside_ns = stamp_ns
            if self._asides < LASTING or stamp_ns > END_NS:
                return place
            self.borne_out = LASTING - 1
            place = Place.RESET if place is Place.PAST else Place.NEXT
        self._aside_ns = None
        if place is not Place.LATE:
            self.newest_ns = stamp_ns
        return place

    def _place(self, stamp_ns: int) -> Place:
        newest_ns = self.newest_ns
        if stamp_ns > END_NS:
            return Place.FUTURE
        if newest_ns is None:
            return Place.NEXT
        behind_ns = newest_ns - stamp_ns
        if is_reset(stamp_ns, newest_ns):
            self._is_far_behind = behind_ns > RESET_NS
            return Place.PAST
        if behind_ns > 0:
            # What follows a jump back is of that other flight, however near it comes.
            follows = self._is_far_behind and self._follows(stamp_ns)
            return Place.PAST if follows else Place.LATE
        return Place.FUTURE if -behind_ns > FUTURE_NS else Place.NEXT

    def _follows(self, stamp_ns: int) -> bool:
        """Whether a stamp agrees with the one that was set aside just before."""
        return self._aside_ns is not None and 0 <= stamp_ns - self._aside_ns <= FUTURE_NS

    def admit(self, stamp_ns: int) -> bool:
        """Take in a stamp [ns] where only what is next counts, and tell whether it is a reset.

        Raises MessageError if it is late, of the past or of an impossible future.
        """
        place = self.place(stamp_ns)
        if place in (Place.NEXT, Place.RESET):
            return place is Place.RESET
        raise self.refusal(place, stamp_ns)

    def refusal(self, place: Place, stamp_ns: int) -> MessageError:
        """Say why a stamp [ns] at such a place is not used."""
        cause: Cause = "future" if place is Place.FUTURE else "late"
        newest_s = None if self.newest_ns is None else seconds(self.newest_ns)
        return MessageError(f"stamped {seconds(stamp_ns)} s, the newest {newest_s} s", cause)


def places(stamps_ns: Iterable[int]) -> list[Place]:
    """Say where the stamps [ns] of a whole stream stand, in hindsight.

    The first of those that bear out a jump back is the reset.
    """
    order = StampOrder()
    found: list[Place] = []
    for stamp_ns in stamps_ns:
        place = order.place(stamp_ns)
        if order.borne_out:
            found[-order.borne_out :] = [place, *[Place.NEXT] * (order.borne_out - 1)]
            place = Place.NEXT
        found.append(place)
    return found
