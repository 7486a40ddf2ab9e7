# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Reading MCAP bags, whole or torn off, without ROS."""

import re
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, CRCValidationError, StreamReader
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

from gtmr_monitor.bag.format import BagError, typestore


class TruncatedBagWarning(UserWarning):
    """A bag that ends in the middle, for example because its writer was killed."""


# What the stream reader raises on a file that ends, or is damaged, in the middle of a record.
_TORN = (
    McapError,
    CRCValidationError,
    ZstdError,
    struct.error,
    UnicodeDecodeError,
    KeyError,
    MemoryError,
    OverflowError,
)


@dataclass(frozen=True)
class BagMessage:
    """One recorded message, still serialised."""

    topic: str
    """Fully qualified topic name."""
    msgtype: str
    """For example ``nav_msgs/msg/Odometry``."""
    log_time_ns: int
    """When it was received, Unix time [ns]."""
    publish_time_ns: int
    """When it was sent, Unix time [ns]; as it was received where the recorder did not know."""
    data: bytes = field(repr=False)
    """The message in CDR."""

    def decode(self) -> Any:
        """Deserialise the message into an object with the fields of the ROS message.

        Raises BagError if the data do not fit the type.
        """
        try:
            return typestore().deserialize_cdr(self.data, self.msgtype)
        except Exception as error:  # rosbags lets struct, index and key errors through
            raise BagError(f"{self.topic}: not a {self.msgtype}: {error}") from None


def bag_files(path: str | Path) -> list[Path]:
    """List the MCAP files of a bag, at least one, in the order in which they were recorded.

    A bag is a rosbag2 folder, with or without its metadata.yaml, or an MCAP file. Raises
    BagError if there is no such path, or no MCAP file in it.
    """
    path = Path(path)
    if not path.exists():
        raise BagError(f"{path}: no such bag")
    if path.is_file():
        return [path]
    files = sorted(path.glob("*.mcap"), key=_split_number)
    if not files:
        raise BagError(f"{path}: not a bag: there is no .mcap file in this folder")
    return files


def read_messages(path: str | Path) -> Iterator[BagMessage]:
    """Read the messages of a bag in the order in which they were recorded.

    A bag without an end is read up to its last whole chunk, with a ``TruncatedBagWarning``. Raises
    BagError if the path is not a bag.
    """
    for file in bag_files(path):
        yield from _read_file(file)


def is_whole(path: str | Path) -> bool:
    """Say whether every file of a bag was closed by its writer.

    Raises BagError if the path is not a bag.
    """
    return all(file.read_bytes()[-MAGIC_SIZE:] == MCAP0_MAGIC for file in bag_files(path))


def _read_file(path: Path) -> Iterator[BagMessage]:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    try:
        stream = path.open("rb")
    except OSError as error:
        raise BagError(f"{path}: cannot read: {error.strerror}") from None
    with stream:
        if stream.read(MAGIC_SIZE) != MCAP0_MAGIC:
            raise BagError(f"{path}: not a bag: this is not an MCAP file")
        stream.seek(0)
        size = path.stat().st_size
        try:
            reader = StreamReader(stream, validate_crcs=True, record_size_limit=size)
            for record in reader.records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    msgtype = schemas[channel.schema_id].name
                    sent_ns = record.publish_time or record.log_time
                    yield BagMessage(channel.topic, msgtype, record.log_time, sent_ns, record.data)
        except _TORN:
            warnings.warn(
                f"{path}: the bag has no end; read up to its last whole chunk",
                TruncatedBagWarning,
                stacklevel=2,
            )


def _split_number(path: Path) -> tuple[int, str]:
    """Rosbag2 numbers the files of a split bag: name_0.mcap, ..., name_10.mcap."""
    match = re.search(r"_(\d+)$", path.stem)
    return (int(match.group(1)) if match else 0, path.name)
