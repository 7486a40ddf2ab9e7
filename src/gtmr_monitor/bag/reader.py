# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Reading MCAP bags, whole or damaged, without ROS."""

import re
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import MAGIC_SIZE, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from gtmr_monitor.bag import losses as cause
from gtmr_monitor.bag import metadata
from gtmr_monitor.bag.format import BagError, typestore
from gtmr_monitor.bag.losses import FileTally, Losses
from gtmr_monitor.bag.metadata import FileTotals
from gtmr_monitor.bag.records import Damaged, Summary, read_summary, walk


class DamagedBagWarning(UserWarning):
    """A bag of which something is missing or damaged."""


class TruncatedBagWarning(DamagedBagWarning):
    """A bag that ends in the middle, for example because its writer was killed."""


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
    place: tuple[int, int] = (0, 0)
    """Number of its file, and its number in its topic there, where the recorder kept count."""
    definition: tuple[Channel, Schema] | None = field(default=None, repr=False, compare=False)
    """How its topic was announced."""

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
    files = sorted(path.glob("*.mcap"), key=split_number)
    if not files:
        raise BagError(f"{path}: not a bag: there is no .mcap file in this folder")
    return files


def read_messages(path: str | Path, losses: Losses | None = None) -> Iterator[BagMessage]:
    """Read the messages of a bag in the order in which they were recorded.

    What is damaged is passed over, and reading goes on behind it, with a ``DamagedBagWarning`` at
    the end; a bag that has no end is read up to its last whole chunk, with a
    ``TruncatedBagWarning``. ``losses`` are told what is missing. Raises BagError if the path is
    not a bag.
    """
    path, losses = Path(path), Losses() if losses is None else losses
    files = bag_files(path)
    contents = _contents(path, losses)
    tallies = [_FileReader(file, number, losses) for number, file in enumerate(files)]
    for tally in tallies:
        try:
            yield from tally.messages(contents if len(files) == 1 else None)
        except BagError:
            if len(files) == 1:
                raise
            losses.causes[cause.UNREADABLE_FILE] += 1
    _compare(files, contents, tallies, losses)
    losses.finish()
    if not losses.has_end:
        text = f"{path}: the bag has no end; read up to its last whole chunk"
        more = Losses(
            losses.causes - Counter({cause.NO_END: losses.causes[cause.NO_END]}), losses.topics
        )
        text += f"; {more}" if more else ""
        warnings.warn(text, TruncatedBagWarning, stacklevel=2)
    elif losses:
        warnings.warn(f"{path}: not whole: {losses}", DamagedBagWarning, stacklevel=2)


def _contents(path: Path, losses: Losses) -> metadata.Contents | None:
    try:
        return metadata.read_contents(path) if path.is_dir() else None
    except ValueError:
        losses.causes[cause.METADATA] += 1
        return None


class _FileReader:
    """One MCAP file; knows what it should hold, and after reading, what it does."""

    def __init__(self, path: Path, number: int, losses: Losses) -> None:
        self._path, self._number, self._losses = path, number, losses
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._chunked = False
        self._damages = 0
        self.tally = FileTally()
        self.expected: dict[str, int] | None = None
        """How many messages each topic has, as its own end says; None if it does not."""

    @property
    def topics(self) -> set[str]:
        """The topics that the file announces, as far as it was read."""
        return {channel.topic for channel in self._channels.values()}

    def messages(self, contents: metadata.Contents | None) -> Iterator[BagMessage]:
        """Read what can be read, and count what cannot; contents are those of this file alone."""
        try:
            data = self._path.read_bytes()
        except OSError as error:
            raise BagError(f"{self._path}: cannot read: {error.strerror}") from None
        summary = read_summary(data)
        if summary is not None:
            self._begin_with(summary)
        begin = MAGIC_SIZE
        if data[:MAGIC_SIZE] != MCAP0_MAGIC:
            self._require_records(data)
            begin = 0
        ended = len(data) > MAGIC_SIZE and data[-MAGIC_SIZE:] == MCAP0_MAGIC
        for at, record in walk(data, begin, len(data) if summary is None else summary.begin):
            if isinstance(record, Damaged) and record.to_the_end and not ended:
                break
            yield from self._messages_of(record)
            if isinstance(record, DataEnd):
                ended = True
                if record.data_section_crc not in (0, zlib.crc32(data[:at])) and not self._damages:
                    self._damage(cause.CHECKSUM)
                break
        if summary is None:
            self._losses.causes[cause.INDEX if ended else cause.NO_END] += 1
        expected = self.expected
        if expected is None and contents is not None:
            expected = dict(contents.topics)
        self._losses.add_file(self.tally.losses(expected, self._damages > 0), self.tally.read)

    def _begin_with(self, summary: Summary) -> None:
        self._schemas, self._channels = dict(summary.schemas), dict(summary.channels)
        if (statistics := summary.statistics) is not None:
            self._chunked = statistics.chunk_count > 0
            names = {channel.id: channel.topic for channel in self._channels.values()}
            counts = statistics.channel_message_counts
            if set(counts) <= set(names):
                self.expected = {names[channel]: n for channel, n in counts.items()}

    def _require_records(self, data: bytes) -> None:
        """Distinguish a bag whose first bytes are damaged from a file that is no bag."""
        first = next((record for _, record in walk(data, 0, len(data))), Damaged(True))
        if isinstance(first, Damaged) and first.to_the_end:
            raise BagError(f"{self._path}: not a bag: this is not an MCAP file")

    def _damage(self, what: str) -> None:
        self._damages += 1
        self._losses.causes[what] += 1

    def _messages_of(self, record: object) -> Iterator[BagMessage]:
        match record:
            case Damaged():
                self._damage(cause.RECORD)
            case Chunk():
                self._chunked = True
                try:
                    inside = breakup_chunk(record, validate_crc=True)
                except Exception:  # damaged data make the decompressor raise anything
                    self._damage(cause.CHUNK)
                    return
                for each in inside:
                    yield from self._take(each)
            case Message() if self._chunked:
                # No writer makes both: a damaged record looks like one.
                self._damage(cause.RECORD)
            case Schema() | Channel() | Message():
                yield from self._take(record)
            case Metadata(name=cause.RECOVERED):
                self._losses.add_metadata(record.metadata)

    def _take(self, record: McapRecord) -> Iterator[BagMessage]:
        """Take in what says what the messages are, and give the messages."""
        match record:
            case Schema():
                self._schemas.setdefault(record.id, record)
            case Channel():
                self._channels.setdefault(record.id, record)
            case Message():
                channel = self._channels.get(record.channel_id)
                schema = None if channel is None else self._schemas.get(channel.schema_id)
                if channel is None or schema is None:
                    self._damage(cause.DEFINITION)
                    return
                self.tally.count(channel.topic, record.sequence)
                yield BagMessage(
                    channel.topic,
                    schema.name,
                    record.log_time,
                    record.publish_time or record.log_time,
                    record.data,
                    (self._number, record.sequence),
                    (channel, schema),
                )


def _compare(
    files: list[Path],
    contents: metadata.Contents | None,
    read: list[_FileReader],
    losses: Losses,
) -> None:
    """Compare what there is with what metadata.yaml, and the numbers of the files, say."""
    names = {file.name for file in files}
    numbers = [split_number(file)[0] for file in files]
    missing = len(range(numbers[0], numbers[-1] + 1)) - len(set(numbers))
    if contents is None:
        losses.causes[cause.MISSING_FILE] += missing
        return
    absent = [name for name in contents.files if name not in names]
    known = [each.expected for each in read]
    totals: Counter[str] = Counter()
    for file in known:
        totals.update(file or {})
    if None not in known and totals.total() == contents.messages:
        # The files' own ends are checked by a sum, metadata.yaml is not.
        wrong = absent or set(contents.files) != names or dict(+totals) != _positive(contents)
        losses.causes[cause.METADATA] += bool(wrong)
        losses.causes[cause.MISSING_FILE] += missing
        return
    losses.causes[cause.MISSING_FILE] += max(missing, len(absent))
    if None not in known and not absent:
        losses.causes[cause.METADATA] += 1
        return
    first_absent = bool(absent) and split_number(Path(absent[0]))[0] < numbers[0]
    last_absent = bool(absent) and split_number(Path(absent[-1]))[0] > numbers[-1]
    at_the_end = last_absent or (not absent and known[-1] is None)
    for topic, n in contents.topics.items():
        there = sum(each.tally.read[topic] for each in read) + losses.topics[topic].total
        if n < there:
            losses.causes[cause.METADATA] = 1
        lost = max(0, n - there)
        loss = losses.topics[topic]
        loss.head += lost if first_absent and not last_absent else 0
        loss.tail += lost if at_the_end else 0
        loss.inside += lost if not (first_absent or at_the_end) else 0


def _positive(contents: metadata.Contents) -> dict[str, int]:
    return {topic: n for topic, n in contents.topics.items() if n > 0}


def topics_in(file: Path) -> set[str]:
    """Name the topics that an MCAP file announces; none if it was torn off before.

    Raises BagError if it is no MCAP file.
    """
    reader = _FileReader(file, 0, Losses())
    next(reader.messages(None), None)
    return reader.topics


def totals_of(file: Path) -> FileTotals:
    """Read what there is in an MCAP file from its end.

    Raises BagError if it has none.
    """
    try:
        summary = read_summary(file.read_bytes())
    except OSError as error:
        raise BagError(f"{file}: cannot read: {error.strerror}") from None
    statistics = None if summary is None else summary.statistics
    if summary is None or statistics is None:
        raise BagError(f"{file}: has no end: gtmr recover makes a whole bag of what is left")
    counts = statistics.channel_message_counts
    return FileTotals(
        file.name,
        statistics.message_start_time,
        statistics.message_end_time,
        {channel.topic: counts.get(channel.id, 0) for channel in summary.channels.values()},
    )


def split_number(path: Path) -> tuple[int, str]:
    """Rosbag2 numbers the files of a split bag: name_0.mcap, ..., name_10.mcap."""
    match = re.search(r"_(\d+)$", path.stem)
    return (int(match.group(1)) if match else 0, path.name)
