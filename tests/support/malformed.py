# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Bytes that are no message, or none that means anything, made of those of a good one."""

import random
import struct
from collections.abc import Callable

STAMP = slice(4, 12)
"""Seconds and nanoseconds, behind the encapsulation header."""
FRAME_LENGTH = slice(12, 16)
"""Length of the frame's name, the first string of a message with a header."""

MALFORMED: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda good: b"",
    "one byte": lambda good: good[:1],
    "no more than the encapsulation": lambda good: good[:4],
    "cut in the stamp": lambda good: good[:9],
    "cut in a string": lambda good: good[:17],
    "cut in half": lambda good: good[: len(good) // 2],
    "unknown encapsulation": lambda good: b"\xff\xff\xff\xff" + good[4:],
    "of the other byte order": lambda good: b"\x00\x00\x00\x00" + good[4:],
    "a string of 2 GB": lambda good: with_bytes(good, FRAME_LENGTH, b"\xff\xff\xff\x7f"),
    "a string of 4 GB": lambda good: with_bytes(good, FRAME_LENGTH, b"\xff\xff\xff\xff"),
    "all ones": lambda good: good[:4] + b"\xff" * (len(good) - 4),
    "random": lambda good: good[:4] + random.Random(1).randbytes(len(good) - 4),
    "at the end of time": lambda good: with_bytes(
        good, STAMP, struct.pack("<iI", 2**31 - 1, 999_999_999)
    ),
}
"""What to make of a good message, by the name of the kind."""


def with_bytes(good: bytes, where: slice, what: bytes) -> bytes:
    """Put other bytes into a message."""
    return good[: where.start] + what + good[where.stop :]
