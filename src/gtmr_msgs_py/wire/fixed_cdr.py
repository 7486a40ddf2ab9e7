# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Messages of a fixed shape as bytes: those of the control loop differ in their numbers only.

To make a message object field by field, turn it into bytes, and back at the other end, takes
several times as long as a step of the controller. Here bytes are laid out once, and then only
numbers are replaced.
"""

import struct

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_msgs_py.wire.stamps import NANOSECONDS

CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""What stands in front of every message (DDSI-RTPS 2.5, section 10.2)."""
STAMP = struct.Struct("<iI")
"""builtin_interfaces/Time: seconds, nanoseconds."""
FLOAT64 = np.dtype("<f8")
"""Aligned to its size, counted from behind what stands in front."""


def stamp_of(data: bytes) -> int | None:
    """Read a message that begins with a stamp [ns] out of CDR bytes; None if they are others."""
    if data[: len(CDR_LITTLE_ENDIAN)] != CDR_LITTLE_ENDIAN:
        return None
    if len(data) < len(CDR_LITTLE_ENDIAN) + STAMP.size:
        return None
    sec, nanosec = STAMP.unpack_from(data, len(CDR_LITTLE_ENDIAN))
    return int(sec * NANOSECONDS + nanosec)


def stamp_alone(stamp_ns: int) -> bytes:
    """Make CDR bytes of a message that is no more than a stamp [ns], as rosgraph_msgs/Clock is."""
    return CDR_LITTLE_ENDIAN + STAMP.pack(*divmod(stamp_ns, NANOSECONDS))


class FixedCdr:
    """The bytes of a message; write its fields in their order."""

    def __init__(self) -> None:
        self._bytes = bytearray(CDR_LITTLE_ENDIAN)
        self._numbers = np.empty(0, dtype=int)
        self._stamps: list[tuple[int, int]] = []

    def header(self, frame_id: str = "", after_ns: int = 0) -> None:
        """Leave room for a stamp, so much later than the message's [ns], and name a frame."""
        self._align(4)
        self._stamps.append((len(self._bytes), after_ns))
        self._bytes += bytes(STAMP.size)
        self.string(frame_id)

    def uint8(self, value: int) -> None:
        """Write a small integer that is the same in every message."""
        self._bytes.append(value)

    def uint32(self, *values: int) -> None:
        """Write integers, or lengths of sequences, that are the same in every message."""
        self._align(4)
        self._bytes += struct.pack(f"<{len(values)}I", *values)

    def string(self, text: str) -> None:
        """Write a string that is the same in every message."""
        encoded = text.encode() + b"\x00"
        self.uint32(len(encoded))
        self._bytes += encoded

    def strings(self, texts: list[str]) -> None:
        """Write a sequence of strings that is the same in every message."""
        self.uint32(len(texts))
        for text in texts:
            self.string(text)

    def float64(self, count: int) -> None:
        """Leave room for numbers; of a sequence, its length comes first, as a `uint32`."""
        self._align(FLOAT64.itemsize)
        first = (len(self._bytes) - len(CDR_LITTLE_ENDIAN)) // FLOAT64.itemsize
        self._numbers = np.append(self._numbers, np.arange(first, first + count))
        self._bytes += bytes(count * FLOAT64.itemsize)

    def pack(self, stamp_ns: int, numbers: ArrayLike) -> bytes:
        """Make a message as CDR bytes, which a publisher takes in its place.

        It has a stamp [ns] in its headers, and every float64 in order, shape (M,).
        """
        data = self._bytes.copy()
        for at, after_ns in self._stamps:
            STAMP.pack_into(data, at, *divmod(stamp_ns + after_ns, NANOSECONDS))
        _float64_of(data)[self._numbers] = numbers
        return bytes(data)

    def unpack(self, data: bytes) -> tuple[int, NDArray[np.float64]] | None:
        """Read the stamp [ns] and every float64 in order, shape (M,), of bytes with one header.

        None if they differ from this message in anything else: then they have to be read as any
        message has.
        """
        if len(data) != len(self._bytes):
            return None
        rest = bytearray(data)
        float64 = _float64_of(rest)
        numbers = float64[self._numbers]
        float64[self._numbers] = 0.0
        ((stamp_at, _),) = self._stamps
        sec, nanosec = STAMP.unpack_from(rest, stamp_at)
        STAMP.pack_into(rest, stamp_at, 0, 0)
        return (sec * NANOSECONDS + nanosec, numbers) if rest == self._bytes else None

    def _align(self, size: int) -> None:
        self._bytes += bytes((len(CDR_LITTLE_ENDIAN) - len(self._bytes)) % size)


def _float64_of(data: bytearray) -> NDArray[np.float64]:
    """Everything behind what stands in front, seen as numbers."""
    count = (len(data) - len(CDR_LITTLE_ENDIAN)) // FLOAT64.itemsize
    return np.frombuffer(data, FLOAT64, count, offset=len(CDR_LITTLE_ENDIAN))
