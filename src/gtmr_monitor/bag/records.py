# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The records of an MCAP file, also of a damaged one: what cannot be read is passed over.

The container's layout is that of the MCAP specification, version 0; single records are read by
the ``mcap`` library.
"""

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import MAGIC_SIZE
from mcap.writer import MCAP0_MAGIC

_HEAD = struct.Struct("<BQ")
"""Opcode and length, in front of every record."""
_INDEX = struct.Struct("<HI")
"""Channel, and bytes of the array, in front of an index of messages."""
_MESSAGE_FIXED_BYTES = 22
_FOOTER_BYTES = 20
_PRIVATE = 0x80
"""Opcodes from here on are private, and are skipped."""
_LAYOUTS: dict[int, Callable[[ReadDataStream], Any]] = {
    Opcode.HEADER: Header.read,
    Opcode.FOOTER: Footer.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.METADATA: Metadata.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
    Opcode.SUMMARY_OFFSET: SummaryOffset.read,
    Opcode.DATA_END: DataEnd.read,
}
# A record begins with its opcode and its length, here below 4 GiB.
_MAYBE_RECORD = re.compile(rb"(?=[\x01-\x0f][\s\S]{4}\x00{4})")
_SURE_ENOUGH = 3
"""So many consecutive records are no coincidence."""


class Damaged:
    """A stretch of a file that holds no record that can be read."""

    def __init__(self, to_the_end: bool) -> None:
        self.to_the_end = to_the_end
        """Whether nothing can be read behind it."""


class Passed:
    """A record that readers do not need: an index of messages, or a private one."""


@dataclass
class Summary:
    """What the summary at the end of a file says."""

    begin: int
    """Where it begins, which is where the data end [bytes]."""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    statistics: Statistics | None = None


def walk(data: bytes, begin: int, end: int) -> Iterator[tuple[int, McapRecord | Damaged | Passed]]:
    """Read the records between two places of a file [bytes], and where each begins.

    Behind damage it goes on.
    """
    at = begin
    while at < end:
        record, size = _parse(data, at, end)
        if record is None:
            following = _next_record(data, at + 1, end)
            yield at, Damaged(to_the_end=following == end)
            at = following
        else:
            yield at, record
            at += size


def read_summary(data: bytes) -> Summary | None:
    """Read the summary of a file that was closed; None if there is none, or it is damaged."""
    foot = len(data) - MAGIC_SIZE - _FOOTER_BYTES - _HEAD.size
    if foot < MAGIC_SIZE or data[-MAGIC_SIZE:] != MCAP0_MAGIC:
        return None
    footer, _ = _parse(data, foot, len(data) - MAGIC_SIZE)
    if isinstance(footer, Footer) and footer.summary_start == 0:
        return Summary(foot)
    if not isinstance(footer, Footer) or not MAGIC_SIZE <= footer.summary_start <= foot:
        return None
    # The checksum covers the footer up to itself.
    checked = data[footer.summary_start : len(data) - MAGIC_SIZE - 4]
    if footer.summary_crc not in (0, zlib.crc32(checked)):
        return None
    summary = Summary(footer.summary_start)
    for _, record in walk(data, footer.summary_start, foot):
        match record:
            case Damaged():
                return None
            case Schema():
                summary.schemas[record.id] = record
            case Channel():
                summary.channels[record.id] = record
            case Statistics():
                summary.statistics = record
    return summary


def _parse(data: bytes, at: int, end: int) -> tuple[McapRecord | Passed | None, int]:
    """Read a record that fits its own length; None if it does not."""
    if at + _HEAD.size > end:
        return None, 0
    opcode, length = _HEAD.unpack_from(data, at)
    begin = at + _HEAD.size
    if begin + length > end:
        return None, 0
    size = _HEAD.size + length
    if opcode >= _PRIVATE:
        return Passed(), size
    if opcode == Opcode.MESSAGE_INDEX:
        return (Passed(), size) if _is_message_index(data, begin, length) else (None, 0)
    content = ReadDataStream(BytesIO(data[begin : begin + length]))
    try:
        if opcode == Opcode.MESSAGE:
            whole = length >= _MESSAGE_FIXED_BYTES
            return (Message.read(content, length), size) if whole else (None, 0)
        record = _LAYOUTS[opcode](content)
    except Exception:  # a damaged record makes the library raise anything
        return None, 0
    return (record, size) if content.count == length else (None, 0)


def _is_message_index(data: bytes, begin: int, length: int) -> bool:
    """Whether a channel and an array of pairs of 8 bytes fit; it has too many to read each."""
    if length < _INDEX.size:
        return False
    _, entries = _INDEX.unpack_from(data, begin)
    return bool(entries % 16 == 0 and length == _INDEX.size + entries)


def _next_record(data: bytes, at: int, end: int) -> int:
    """Find where a record begins, or the end."""
    for match in _MAYBE_RECORD.finditer(data, at, end):
        if _is_record(data, match.start(), end):
            return match.start()
    return end


def _is_record(data: bytes, at: int, end: int) -> bool:
    """Whether it is one by itself, as chunks are, whose lengths agree, or by what follows it."""
    for _ in range(_SURE_ENOUGH):
        record, size = _parse(data, at, end)
        if record is None:
            return False
        if isinstance(record, Chunk | Footer) or data[at] == Opcode.MESSAGE_INDEX:
            return True
        at += size
    return True
