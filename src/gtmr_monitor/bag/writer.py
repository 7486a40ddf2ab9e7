# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Writing a rosbag2 folder that survives being killed: metadata.yaml (version 9) and MCAP."""

import math
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, cast

import yaml
from mcap.well_known import SchemaEncoding
from mcap.writer import CompressionType, Writer
from typing_extensions import Self

from gtmr_monitor.bag.format import BagError, typestore
from gtmr_monitor.bag.metadata import OfferedQos

METADATA_VERSION = 9
"""Version of rosbag2's metadata.yaml, Jazzy's."""
ROS_DISTRO = "jazzy"
"""Whose message definitions the bag carries."""
FLUSH_PERIOD_S = 0.5
"""Age at which a chunk is closed and handed to the operating system [s]. A killed writer loses
what is younger; half of the second that may be lost leaves room for a busy machine."""


@dataclass
class _Channel:
    id: int
    metadata: dict[str, Any]
    count: int = 0


class _File:
    """A new file without a buffer, so that nothing is left behind in a killed process."""

    def __init__(self, path: Path) -> None:
        self._raw = path.open("xb", buffering=0)

    @property
    def closed(self) -> bool:
        return self._raw.closed

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            rest = rest[self._raw.write(rest) :]
        return len(data)

    def tell(self) -> int:
        return self._raw.tell()

    def flush(self) -> None:
        pass

    def truncate(self, size: int) -> None:
        self._raw.truncate(size)

    def close(self) -> None:
        os.fsync(self._raw.fileno())
        self._raw.close()


class BagWriter:
    """Writes serialised messages into a new rosbag2 folder, which is made if it does not exist.

    A chunk is closed and flushed to the operating system at the latest with the first write after
    ``flush_period_s`` [s], or by :meth:`flush`. Nothing that exists is ever overwritten. Raises
    BagError if the folder is not empty, is no folder, or cannot be written.
    """

    def __init__(self, folder: str | Path, flush_period_s: float = FLUSH_PERIOD_S) -> None:
        self.folder = Path(folder)
        self.messages = 0
        """How many messages were written."""
        self._flush_period_s = flush_period_s
        self._channels: dict[str, _Channel] = {}
        self._schemas: dict[str, int] = {}
        self._start_ns: float = math.inf
        self._end_ns = 0
        self._flushed_at = time.monotonic()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if any(self.folder.iterdir()):
                raise BagError(f"{self.folder}: the folder is not empty; give a new one")
            self._path = self.folder / f"{self.folder.resolve().name}_0.mcap"
            self._file = _File(self._path)
        except FileExistsError:
            raise BagError(f"{self.folder}: exists and is not an empty folder") from None
        except OSError as error:
            raise BagError(f"{self.folder}: cannot write a bag: {error.strerror}") from None
        # The writer uses no more of a stream than what _File has.
        self._mcap = Writer(cast("IO[bytes]", self._file), compression=CompressionType.ZSTD)
        self._mcap.start(profile="ros2")
        self._mcap.flush()
        self._intact_bytes = self._file.tell()

    @property
    def size_bytes(self) -> int:
        """What the operating system has of the bag so far [bytes]."""
        return self._intact_bytes

    def add_topic(self, name: str, msgtype: str, qos: OfferedQos | None = None) -> None:
        """Announce a topic by its full name; its message definition goes into the bag.

        Raises BagError if the message type is not one of Jazzy's.
        """
        store = typestore()
        if msgtype not in store.types:
            raise BagError(f"{name}: {msgtype} is not a message type of ROS 2 {ROS_DISTRO}")
        if msgtype not in self._schemas:
            definition, _ = store.generate_msgdef(msgtype, ros_version=2)
            self._schemas[msgtype] = self._mcap.register_schema(
                msgtype, SchemaEncoding.ROS2, definition.encode()
            )
        profiles = [(qos or OfferedQos()).profile()]
        type_hash = store.hash_rihs01(msgtype)
        channel_id = self._mcap.register_channel(
            name,
            "cdr",
            self._schemas[msgtype],
            {
                "offered_qos_profiles": yaml.safe_dump(profiles, sort_keys=False),
                "topic_type_hash": type_hash,
            },
        )
        self._channels[name] = _Channel(
            channel_id,
            {
                "name": name,
                "type": msgtype,
                "serialization_format": "cdr",
                "offered_qos_profiles": profiles,
                "type_description_hash": type_hash,
            },
        )

    def write(
        self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Append a message in CDR, received and sent at those Unix times [ns].

        Raises BagError if the medium takes no more; the bag then ends at its last whole chunk.
        """
        channel = self._channels[topic]
        try:
            self._mcap.add_message(
                channel.id,
                log_time=log_time_ns,
                data=data,
                publish_time=log_time_ns if publish_time_ns is None else publish_time_ns,
                sequence=channel.count,
            )
        except OSError as error:
            self._give_up(error)
        channel.count += 1
        self.messages += 1
        self._start_ns = min(self._start_ns, log_time_ns)
        self._end_ns = max(self._end_ns, log_time_ns)
        if time.monotonic() - self._flushed_at >= self._flush_period_s:
            self.flush()

    def flush(self) -> None:
        """Close the chunk in progress and hand it to the operating system.

        Raises BagError if the medium takes no more; the bag then ends at its last whole chunk.
        """
        try:
            self._mcap.flush()
        except OSError as error:
            self._give_up(error)
        self._intact_bytes = self._file.tell()
        self._flushed_at = time.monotonic()

    def close(self) -> None:
        """Write index and metadata.yaml; a second call does nothing.

        Raises BagError if the medium takes no more.
        """
        if self._file.closed:
            return
        information = self._information()
        try:
            self._mcap.add_metadata("rosbag2", {"serialized_metadata": _dump(information)})
            self._mcap.finish()
            self._file.close()
            # A reader takes a folder with metadata.yaml for a whole bag: it must appear at once.
            draft = self.folder / "metadata.yaml.tmp"
            draft.write_text(_dump({"rosbag2_bagfile_information": information}), encoding="utf-8")
            draft.replace(self.folder / "metadata.yaml")
        except OSError as error:
            self._give_up(error)

    def __enter__(self) -> Self:
        """Return the writer, which the end of the block closes."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag, whatever happened in the block."""
        self.close()

    def _give_up(self, error: OSError) -> None:
        """Drop the torn tail, so that what was written before stays readable."""
        if not self._file.closed:
            self._file.truncate(self._intact_bytes)
            self._file.close()
        raise BagError(f"{self._path}: cannot write: {error.strerror}") from None

    def _information(self) -> dict[str, Any]:
        start_ns = 0 if math.isinf(self._start_ns) else int(self._start_ns)
        span: Mapping[str, Any] = {
            "starting_time": {"nanoseconds_since_epoch": start_ns},
            "duration": {"nanoseconds": max(0, self._end_ns - start_ns)},
            "message_count": self.messages,
        }
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": [
                {"topic_metadata": channel.metadata, "message_count": channel.count}
                for channel in self._channels.values()
            ],
            # MCAP compresses its chunks by itself; this names rosbag2's own compression: none.
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._path.name],
            "files": [{"path": self._path.name, **span}],
            "custom_data": None,
            "ros_distro": ROS_DISTRO,
        }


class _NoAliases(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _dump(data: Any) -> str:
    return yaml.dump(data, Dumper=_NoAliases, sort_keys=False)
