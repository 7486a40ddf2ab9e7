# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Writing a rosbag2 folder that survives being killed: metadata.yaml (version 9) and MCAP."""

import fcntl
import math
import os
import re
import time
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, cast

import yaml
from mcap.records import Channel, Schema
from mcap.well_known import SchemaEncoding
from mcap.writer import CompressionType, Writer
from typing_extensions import Self

from gtmr_monitor.bag import metadata
from gtmr_monitor.bag.format import BagError, typestore
from gtmr_monitor.bag.metadata import METADATA_VERSION, ROS_DISTRO, FileTotals, OfferedQos
from gtmr_monitor.bag.reader import bag_files, split_number, topics_in, totals_of

FLUSH_PERIOD_S = 0.5
"""Age at which a chunk is closed and handed to the operating system [s]. A killed writer loses
what is younger; half of the second that may be lost leaves room for a busy machine."""


@dataclass
class _Channel:
    id: int
    metadata: dict[str, Any]
    count: int = 0


class _File:
    """A new file without a buffer, so that nothing is left behind in a killed process.

    It is locked until it is closed or its process ends, so that no reader takes it for a torn one.
    """

    def __init__(self, path: Path) -> None:
        self._raw = path.open("xb", buffering=0)
        # Some file systems have no locks.
        with suppress(OSError):
            fcntl.flock(self._raw, fcntl.LOCK_EX | fcntl.LOCK_NB)

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

    def discard(self, path: Path) -> None:
        """Remove the file, into which nothing worth keeping was written."""
        self._raw.close()
        path.unlink(missing_ok=True)

    def truncate(self, size: int) -> None:
        self._raw.truncate(size)

    def close(self) -> None:
        try:
            os.fsync(self._raw.fileno())
        finally:
            self._raw.close()


class BagWriter:
    """Writes serialised messages into a rosbag2 folder, which is made if it does not exist.

    A chunk is closed and flushed to the operating system at the latest with the first write after
    ``flush_period_s`` [s], or by :meth:`flush`. Nothing that exists is ever overwritten: in a
    folder with a bag of no other topics than ``resume`` it goes on in another file, for one
    recorder after the other. Raises BagError if the folder holds anything else, is being written
    by another recorder, is no folder, or cannot be written.
    """

    def __init__(
        self,
        folder: str | Path,
        flush_period_s: float = FLUSH_PERIOD_S,
        resume: Collection[str] = (),
    ) -> None:
        self.folder = Path(folder)
        self.messages = 0
        """How many messages were written."""
        self.unflushed = 0
        """How many of them a failure of the disk would lose."""
        self._flush_period_s = flush_period_s
        self._channels: dict[str, _Channel] = {}
        self._schemas: dict[str, int] = {}
        self._start_ns: float = math.inf
        self._end_ns = 0
        self._flushed_at = time.monotonic()
        self._has_end = self._closed = False
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._earlier = self._files_to_go_on_from(resume)
            number = 1 + max((split_number(file)[0] for file in self._earlier), default=-1)
            self._path = self.folder / f"{self.folder.resolve().name}_{number}.mcap"
            self._file = _File(self._path)
        except FileExistsError:
            raise BagError(f"{self.folder}: exists and is not an empty folder") from None
        except OSError as error:
            raise BagError(f"{self.folder}: cannot write a bag: {error.strerror}") from None
        # The writer uses no more of a stream than what _File has.
        self._mcap = Writer(cast("IO[bytes]", self._file), compression=CompressionType.ZSTD)
        try:
            self._mcap.start(profile="ros2")
            self._mcap.flush()
            # It would hide this file from readers that rely on it.
            (self.folder / metadata.FILE_NAME).unlink(missing_ok=True)
        except OSError as error:
            self._file.discard(self._path)
            raise BagError(f"{self.folder}: cannot write a bag: {error.strerror}") from None
        self._intact_bytes = self._file.tell()

    @property
    def resumed(self) -> bool:
        """Whether the folder held files of the bag before."""
        return bool(self._earlier)

    @property
    def size_bytes(self) -> int:
        """How much of the bag the operating system has [bytes]."""
        return self._intact_bytes

    def add_topic(self, name: str, msgtype: str, qos: OfferedQos | None = None) -> None:
        """Announce a topic by its full name; its message definition goes into the bag.

        Raises BagError if the message type is not one of Jazzy's.
        """
        store = typestore()
        if msgtype not in store.types:
            raise BagError(f"{name}: {msgtype} is not a message type of ROS 2 {ROS_DISTRO}")
        definition, _ = store.generate_msgdef(msgtype, ros_version=2)
        schema = Schema(0, definition.encode(), SchemaEncoding.ROS2, msgtype)
        profiles = [(qos or OfferedQos()).profile()]
        self._announce(name, "cdr", schema, profiles, store.hash_rihs01(msgtype))

    def add_topic_of(self, channel: Channel, schema: Schema) -> None:
        """Announce a topic as another bag does, also one whose message type is not of Jazzy."""
        profiles = metadata.profiles_in(channel.metadata.get("offered_qos_profiles", ""))
        type_hash = channel.metadata.get("topic_type_hash", "")
        self._announce(channel.topic, channel.message_encoding, schema, profiles, type_hash)

    def _announce(
        self,
        name: str,
        encoding: str,
        schema: Schema,
        profiles: list[dict[str, Any]],
        type_hash: str,
    ) -> None:
        if schema.name not in self._schemas:
            self._schemas[schema.name] = self._mcap.register_schema(
                schema.name, schema.encoding, schema.data
            )
        channel_id = self._mcap.register_channel(
            name,
            encoding,
            self._schemas[schema.name],
            {
                "offered_qos_profiles": yaml.safe_dump(profiles, sort_keys=False),
                "topic_type_hash": type_hash,
            },
        )
        self._channels[name] = _Channel(
            channel_id,
            {
                "name": name,
                "type": schema.name,
                "serialization_format": encoding,
                "offered_qos_profiles": profiles,
                "type_description_hash": type_hash,
            },
        )

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Write metadata of this file.

        Raises BagError if the medium takes no more.
        """
        try:
            self._mcap.add_metadata(name, data)
        except OSError as error:
            self._give_up(error)

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
        self.unflushed += 1
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
        self.unflushed = 0
        self._flushed_at = time.monotonic()

    def end_file(self) -> None:
        """Write the index; a second call does nothing.

        Raises BagError if the medium takes no more.
        """
        if self._file.closed:
            return
        try:
            self._mcap.add_metadata("rosbag2", {"serialized_metadata": _dump(self._of_file())})
            self._mcap.finish()
            self._file.close()
        except OSError as error:
            self._give_up(error)
        self.unflushed = 0
        self._has_end = True

    def close(self) -> None:
        """Write index and metadata.yaml; after a failure, or a second time, it does nothing.

        Raises BagError if the medium takes no more, or an earlier file of the bag has no end: then
        there is no metadata.yaml either.
        """
        self.end_file()
        if not self._has_end or self._closed:
            return
        self._closed = True
        information = self._of_all_files()
        try:
            # A reader takes a folder with metadata.yaml for a whole bag: it must appear at once.
            draft = self.folder / metadata.DRAFT_NAME
            draft.write_text(_dump({"rosbag2_bagfile_information": information}), encoding="utf-8")
            draft.replace(self.folder / metadata.FILE_NAME)
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
        """Close the bag, also after an exception in the block."""
        self.close()

    def _give_up(self, error: OSError) -> None:
        """Drop the torn tail, so that what was written before stays readable."""
        if not self._file.closed:
            with suppress(OSError):
                self._file.truncate(self._intact_bytes)
            with suppress(OSError):
                self._file.close()
        raise BagError(f"{self._path}: cannot write: {error.strerror}") from None

    def _files_to_go_on_from(self, resume: Collection[str]) -> list[Path]:
        """List the files of the bag that is there; BagError if there is anything else."""
        there = sorted(path.name for path in self.folder.iterdir())
        if not there:
            return []
        own = re.compile(rf"{re.escape(self.folder.resolve().name)}_\d+\.mcap")
        strange = [n for n in there if n not in metadata.LEFTOVERS and not own.fullmatch(n)]
        if strange or not resume:
            raise BagError(f"{self.folder}: the folder is not empty; give a new one")
        files = [file for file in bag_files(self.folder) if own.fullmatch(file.name)]
        if any(map(_is_being_written, files)):
            raise BagError(f"{self.folder}: another recorder is writing it; give a new one")
        others = {topic for file in files for topic in topics_in(file)} - set(resume)
        if others:
            raise BagError(
                f"{self.folder}: holds a bag of other topics, such as {min(others)}; give a new "
                "folder"
            )
        return files

    def _of_file(self) -> dict[str, Any]:
        return self._information([self._totals()])

    def _of_all_files(self) -> dict[str, Any]:
        return self._information([*map(totals_of, self._earlier), self._totals()])

    def _totals(self) -> FileTotals:
        start_ns = 0 if math.isinf(self._start_ns) else int(self._start_ns)
        counts = {name: channel.count for name, channel in self._channels.items()}
        return FileTotals(self._path.name, start_ns, self._end_ns, counts)

    def _information(self, files: list[FileTotals]) -> dict[str, Any]:
        written = [file for file in files if file.messages]
        start_ns = min((file.start_ns for file in written), default=0)
        end_ns = max((file.end_ns for file in written), default=0)
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            **_span(start_ns, end_ns, sum(file.messages for file in files)),
            "topics_with_message_count": [
                {
                    "topic_metadata": channel.metadata,
                    "message_count": sum(file.counts.get(name, 0) for file in files),
                }
                for name, channel in self._channels.items()
            ],
            # MCAP compresses its chunks by itself; this names rosbag2's own compression: none.
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file.name for file in files],
            "files": [
                {"path": file.name, **_span(file.start_ns, file.end_ns, file.messages)}
                for file in files
            ],
            "custom_data": None,
            "ros_distro": ROS_DISTRO,
        }


def _is_being_written(file: Path) -> bool:
    with file.open("rb") as raw:
        try:
            fcntl.flock(raw, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
    return False


def _span(start_ns: int, end_ns: int, messages: int) -> Mapping[str, Any]:
    return {
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "duration": {"nanoseconds": max(0, end_ns - start_ns)},
        "message_count": messages,
    }


class _NoAliases(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _dump(data: Any) -> str:
    return yaml.dump(data, Dumper=_NoAliases, sort_keys=False)
