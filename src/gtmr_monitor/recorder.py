# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Recording that may fail in flight: a full disk is no reason to stop watching."""

from collections.abc import Callable

from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.metadata import OfferedQos
from gtmr_monitor.bag.writer import BagWriter


class Recorder:
    """A bag until it cannot be written; from then on it only counts what it lacks.

    The folder is new or empty, or "" for no recording; ``on_failure`` is told in one line what
    went wrong.

    Raises BagError if there can be no bag in the folder.
    """

    def __init__(self, folder: str, on_failure: Callable[[str], object]) -> None:
        self._bag = BagWriter(folder) if folder else None
        self._on_failure = on_failure
        self.folder = folder
        """Where it is; "" for nowhere."""
        self.unwritten = 0
        """How many messages came when the bag could not be written any more."""

    @property
    def active(self) -> bool:
        """Whether the bag is being written."""
        return self._bag is not None

    @property
    def messages(self) -> int:
        """How many messages are in the bag; 0 after a failure."""
        return self._bag.messages if self._bag is not None else 0

    @property
    def size_bytes(self) -> int:
        """How large the bag is; 0 after a failure."""
        return self._bag.size_bytes if self._bag is not None else 0

    def add_topic(self, topic: str, msgtype: str, qos: OfferedQos) -> None:
        """Make a topic known before its first message, see `BagWriter.add_topic`."""
        if self._bag is not None:
            self._bag.add_topic(topic, msgtype, qos)

    def write(
        self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Write a message, see `BagWriter.write`; a failure ends the recording."""
        if self._bag is None:
            self.unwritten += bool(self.folder)
            return
        try:
            self._bag.write(topic, data, log_time_ns, publish_time_ns)
        except BagError as error:
            self._give_up(error)

    def flush(self) -> None:
        """Put what is written out of reach of a crash; a failure ends the recording."""
        if self._bag is not None:
            try:
                self._bag.flush()
            except BagError as error:
                self._give_up(error)

    def close(self) -> None:
        """End the bag."""
        bag, self._bag = self._bag, None
        if bag is not None:
            try:
                bag.close()
            except BagError as error:
                self._on_failure(str(error))

    def _give_up(self, error: BagError) -> None:
        self._bag = None
        self.unwritten += 1
        self._on_failure(f"stopped recording: {error}")
