# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The status of a node, once a second, as diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus

from gtmr_msgs_py.wire.fixed_cdr import FixedCdr

if TYPE_CHECKING:
    from rclpy.node import Node

Value = str | bool | int | float


class Level(IntEnum):
    """How a node is doing."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


def source(node: Node) -> str:
    """Name the source: a node's name with its namespace, ``nmpc`` or ``hex1/nmpc``.

    Viewers group statuses by the part of their name before the colon.
    """
    return str(node.get_fully_qualified_name()).lstrip("/")


def pack(
    stamp_ns: int,
    name: str,
    level: Level,
    message: str,
    values: Mapping[str, Value],
    hardware_id: str = "",
) -> bytes:
    """Make CDR bytes of a diagnostic_msgs/DiagnosticArray: how a node is doing.

    The name says what is diagnosed, for example ``nmpc: controller``; the message tells the level
    in words, the values are figures by name, which ends in the unit; the hardware is a vehicle.
    """
    array = FixedCdr()
    array.header()
    # One status.
    array.uint32(1)
    array.uint8(level)
    for text in (name, message, hardware_id):
        array.string(text)
    array.uint32(len(values))
    for key, value in values.items():
        array.string(key)
        array.string(_text(value))
    return array.pack(stamp_ns, ())


def decode(status: DiagnosticStatus) -> dict[str, Value]:
    """Read the figures of a status.

    Whole numbers, other numbers, true and false are what they are, everything else is text.
    """
    return {pair.key: _value(pair.value) for pair in status.values}


def _text(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)


def _value(text: str) -> Value:
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
