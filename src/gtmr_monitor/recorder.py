# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Recording that may fail in flight: a full disk is no reason to stop watching."""

import shutil
import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.metadata import OfferedQos
from gtmr_monitor.bag.reader import DamagedBagWarning, bag_files, totals_of
from gtmr_monitor.bag.writer import BagWriter
from gtmr_monitor.recover import mend

ROOM_BYTES = 1 << 18
"""What must be free before recording goes on: a few chunks [bytes]."""
RETRY_S = 1.0
"""Between two looks whether there is room again, wall time [s]."""

Topics = Mapping[str, tuple[str, OfferedQos]]
"""Message type and quality of service by the topic's full name."""


class Recorder:
    """A bag that goes on in another file when the disk has room again, and counts what it lacks.

    The folder is new or empty, or holds a bag of the same topics, in which it goes on; or it is ""
    for no recording. ``tell`` is told in one line what went wrong, and when it goes on.

    Raises BagError if there can be no bag in the folder.
    """

    def __init__(self, folder: str, topics: Topics, tell: Callable[[str], object]) -> None:
        self.folder = folder
        """Where it is; "" for nowhere."""
        self.unwritten = 0
        """How many messages are not in the bag because it could not be written."""
        self._topics = topics
        self._tell = tell
        self._retry_at_s = 0.0
        self._ended_messages = 0
        self._bag = self._open() if folder else None
        self._resumed = self._bag is not None and self._bag.resumed

    @property
    def active(self) -> bool:
        """Whether the bag is being written."""
        return self._bag is not None

    @property
    def resumed(self) -> bool:
        """Whether the folder held a bag before."""
        return self._resumed

    @property
    def stopped(self) -> bool:
        """Whether a bag is to be written but cannot be."""
        return self._bag is None and bool(self.folder)

    @property
    def messages(self) -> int:
        """How many messages this recorder has in the bag."""
        return self._ended_messages + (self._bag.messages if self._bag is not None else 0)

    @property
    def size_bytes(self) -> int:
        """How large the file is that is being written [bytes]; 0 after a failure."""
        return self._bag.size_bytes if self._bag is not None else 0

    def write(
        self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Write a message, see `BagWriter.write`; a failure stops the recording for a while."""
        if not self.folder:
            return
        if self._bag is None:
            self._try_again()
        if self._bag is None:
            self.unwritten += 1
            return
        bag, before = self._bag, self._bag.messages
        try:
            bag.write(topic, data, log_time_ns, publish_time_ns)
        except BagError as error:
            self._stop(bag, error, before + 1 - bag.messages)

    def flush(self) -> None:
        """Put what is written out of reach of a crash; a failure stops the recording."""
        if self._bag is not None:
            try:
                self._bag.flush()
            except BagError as error:
                self._stop(self._bag, error, 0)

    def close(self) -> None:
        """End the bag, also those of its files that a failure or a kill left without an end."""
        if self.stopped:
            self._retry_at_s = 0.0
            self._try_again()
        bag, self._bag = self._bag, None
        if bag is None:
            return
        try:
            bag.end_file()
            for file in bag_files(self.folder):
                _end(file)
            bag.close()
        except BagError as error:
            self._tell(str(error))

    def _open(self) -> BagWriter:
        bag = BagWriter(self.folder, resume=self._topics)
        for name, (msgtype, qos) in self._topics.items():
            bag.add_topic(name, msgtype, qos)
        return bag

    def _stop(self, bag: BagWriter, error: BagError, more: int) -> None:
        """Count what the failure took along, and more messages that were not even taken in."""
        self._bag = None
        self._ended_messages += bag.messages - bag.unflushed
        self.unwritten += bag.unflushed + more
        self._retry_at_s = time.monotonic() + RETRY_S
        self._tell(f"stopped recording: {error}")

    def _try_again(self) -> None:
        if time.monotonic() < self._retry_at_s:
            return
        self._retry_at_s = time.monotonic() + RETRY_S
        try:
            if shutil.disk_usage(self.folder).free >= ROOM_BYTES:
                self._bag = self._open()
        except (BagError, OSError):
            return
        if self._bag is not None:
            self._tell(f"recording goes on; {self.unwritten} messages are missing in between")


def _end(file: Path) -> None:
    """Give a file an end if it has none."""
    try:
        totals_of(file)
    except BagError:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DamagedBagWarning)
            mend(file)
