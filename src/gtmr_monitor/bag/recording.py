# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a bag recorded of one vehicle's flight: its messages, in the order of their stamps.

Reports make a `Flight` of it, replays feed it to the controller.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.reader import BagMessage
from gtmr_monitor.coverage import Coverage
from gtmr_msgs_py.wire import stamps
from gtmr_msgs_py.wire.order import Place, is_reset, places

# Indexed by the type of a rcl_interfaces/msg/ParameterValue.
_VALUE_FIELDS = (
    None, "bool_value", "integer_value", "double_value", "string_value", "byte_array_value",
    "bool_array_value", "integer_array_value", "double_array_value", "string_array_value",
)  # fmt: skip

STRAY_NS = 500_000_000
"""Between stamps closer than this [ns] there is no reset."""


@dataclass(frozen=True)
class Recorded:
    """A message of a bag, decoded."""

    stamp_ns: int
    """Of its header [ns]; when it was received, if it has none."""
    received_ns: int
    """When it was recorded, Unix time [ns]."""
    sent_ns: int
    """When it was sent, Unix time [ns]."""
    message: Any
    """With the fields of the ROS message."""
    place: tuple[int, int] = (0, 0)
    """See `BagMessage`."""


@dataclass(frozen=True)
class Change:
    """Parameters of a node that took another value, or were first heard of."""

    node: str
    """Fully qualified name."""
    received_ns: int
    """When it was recorded, Unix time [ns]."""
    sent_ns: int
    """When it was told, Unix time [ns]."""
    values: dict[str, Any]
    """By name."""


@dataclass(frozen=True)
class Recording:
    """One vehicle's flight in a bag, after the last reset of the simulation.

    What bears a stamp is in the order of the stamps, each stamp once: waiting nodes repeat
    themselves.
    """

    path: Path
    """The bag."""
    name: str
    """What to call the flight."""
    odom: str
    """Topic of the odometry."""
    rotors: str | None
    """Topic of the rotor speeds; None if there is none."""
    node: str
    """Fully qualified name of the controller."""
    odometry: list[Recorded]
    """Those whose pose is finite; at least one."""
    ground_truth: list[Recorded]
    """The true state, of the same flight; none if that was not recorded."""
    before_reset: list[Recorded]
    """The same, from before the last reset of the simulation."""
    rotor_states: list[Recorded]
    """Speeds [rad/s]."""
    commands: list[Recorded]
    """The controller's plans, stamped with the time from which they act."""
    command_order: list[int]
    """Stamps of the commands [ns] in the order in which they were sent."""
    tightening: list[Recorded]
    """In the order in which they were received, as have those below."""
    solve_times: list[Recorded]
    """[s]."""
    residuals: list[Recorded]
    """s as the monitor published it [m]."""
    predicted_paths: list[Recorded]
    """The plans' poses [m]."""
    guard: list[Recorded]
    """Whether the guard was in charge, sent with every odometry."""
    changes: list[Change]
    """Of all nodes, in the order in which they were told."""
    late: dict[str, int]
    """By topic of the contract, how many messages came behind newer ones; none is left out."""
    notes: tuple[str, ...]
    """What a user should know, one sentence each."""
    truncated: bool
    """Whether the bag has no end, because its writer was killed."""
    coverage: Coverage
    """What of the flight the bag covers."""

    @property
    def namespace(self) -> str:
        """Of the controller, with a leading slash; empty for none."""
        return self.node.rpartition("/")[0]

    @property
    def start_ns(self) -> int:
        """Stamp of the first odometry [ns]: the flight's time zero."""
        return self.odometry[0].stamp_ns

    @property
    def controller_changes(self) -> list[Change]:
        """The changes of the controller's parameters."""
        return [change for change in self.changes if change.node == self.node]


def decoded(messages: Iterable[BagMessage], dropped: Counter[str]) -> list[Recorded]:
    """Decode messages, in the order in which they come; count those that cannot be."""
    result = []
    for raw in messages:
        try:
            message = raw.decode()
        except BagError:
            dropped[f"undecodable {raw.topic.rpartition('/')[2]}"] += 1
            continue
        header = getattr(message, "header", None)
        stamp_ns = raw.log_time_ns if header is None else stamps.decode(header.stamp)
        result.append(Recorded(stamp_ns, raw.log_time_ns, raw.publish_time_ns, message, raw.place))
    return result


def without_strays(received: list[Recorded]) -> list[Recorded]:
    """Leave out single messages whose stamps are far from those of both their neighbours.

    These go on from one to the other: it is neither a reset nor a gap. At the end it is one that
    falls back, or runs ahead by far more time than went by. Of several in a row, those are left
    out that do not last as long as a node in flight asks for, see `StampOrder`.
    """

    def is_stray(k: int) -> bool:
        now_ns = received[k].stamp_ns
        if k == 0:
            return len(received) > 2 and is_reset(received[1].stamp_ns, now_ns)
        before = received[k - 1]
        if k == len(received) - 1:
            passed_ns = received[k].received_ns - before.received_ns
            leap_ns = now_ns - before.stamp_ns
            return k > 1 and (
                is_reset(now_ns, before.stamp_ns) or leap_ns > STRAY_NS + 100 * abs(passed_ns)
            )
        after_ns = received[k + 1].stamp_ns
        go_on = 0 <= after_ns - before.stamp_ns < STRAY_NS
        ahead, back = is_reset(after_ns, now_ns), is_reset(now_ns, before.stamp_ns)
        return go_on and (ahead or back)

    left = [item for k, item in enumerate(received) if not is_stray(k)]
    found = places([item.stamp_ns for item in left])
    strays = (Place.PAST, Place.FUTURE)
    return [item for item, place in zip(left, found, strict=True) if place not in strays]


def last_flight(received: list[Recorded]) -> tuple[list[Recorded], list[Recorded], int]:
    """Sort what came after the last reset by its stamps, each stamp once.

    Returned too: what came before the reset, as it came, and how many of those flown were late.
    """
    found = places([item.stamp_ns for item in received])
    begin = max((k for k, place in enumerate(found) if place is Place.RESET), default=0)
    first = {item.stamp_ns: item for item in reversed(received[begin:])}
    late = found[begin:].count(Place.LATE)
    return [first[stamp_ns] for stamp_ns in sorted(first)], received[:begin], late


def changes(events: Iterable[BagMessage], dropped: Counter[str]) -> list[Change]:
    """Read the parameters that nodes published, in order; count what cannot be decoded."""
    told = []
    for item in decoded(events, dropped):
        parameters = (*item.message.new_parameters, *item.message.changed_parameters)
        values = {parameter.name: _value(parameter.value) for parameter in parameters}
        told.append(Change(item.message.node, item.received_ns, item.sent_ns, values))
    return sorted(told, key=lambda change: change.sent_ns)


def _value(value: Any) -> Any:
    """Read a ``rcl_interfaces/msg/ParameterValue``."""
    name = _VALUE_FIELDS[value.type] if value.type < len(_VALUE_FIELDS) else None
    plain = getattr(value, name) if name else None
    return plain.tolist() if isinstance(plain, np.ndarray) else plain
