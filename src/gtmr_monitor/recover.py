# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A whole bag of what is left of a damaged one."""

import shutil
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gtmr_monitor.bag.format import BagError, typestore
from gtmr_monitor.bag.losses import NO_END, RECOVERED, Losses
from gtmr_monitor.bag.metadata import MENDING_NAME
from gtmr_monitor.bag.reader import BagMessage, read_messages
from gtmr_monitor.bag.vehicles import read_recordings
from gtmr_monitor.bag.writer import BagWriter
from gtmr_monitor.coverage import Coverage


@dataclass(frozen=True)
class Recovered:
    """What could be recovered of a bag."""

    source: Path
    """The damaged bag."""
    bag: Path
    """The whole one, a rosbag2 folder."""
    messages: int
    """How many messages it holds."""
    losses: Losses
    """What it lacks."""
    coverage: dict[str, Coverage]
    """What of each flight it covers, by topic of the odometry."""

    def result(self) -> dict[str, Any]:
        """Sum up as plain data."""
        return {
            "bag": str(self.bag),
            "source": str(self.source),
            "messages": self.messages,
            "causes": dict(self.losses.causes),
            "lost_messages": self.losses.messages,
            "vehicles": {
                odom: {"coverage": coverage.as_json()} for odom, coverage in self.coverage.items()
            },
        }


def recover(source: str | Path, out: str | Path) -> Recovered:
    """Write what is left of a bag into a new one, which says in its metadata what it lacks.

    Messages stay in the order in which they were recorded; what cannot be decoded is left out.
    Gives a ``DamagedBagWarning`` as `read_messages`. Raises BagError if nothing is left, or the
    new folder is not empty or cannot be written.
    """
    source, out = Path(source), Path(out)
    losses = Losses()
    messages = _copy(source, out, losses)
    try:
        coverage = {r.odom: r.coverage for r in read_recordings(out)}
    except BagError:
        coverage = {}
    return Recovered(source, out, messages, losses, coverage)


def mend(file: Path) -> None:
    """Put in place of an MCAP file that was torn off one with an end, of what is left of it.

    Gives a ``DamagedBagWarning`` as `read_messages`. Raises BagError if nothing is left, or it
    cannot be written; the file then stays as it is.
    """
    scratch = file.parent / MENDING_NAME
    shutil.rmtree(scratch, ignore_errors=True)
    try:
        _copy(file, scratch, Losses(), may_be_empty=True)
        (whole,) = scratch.glob("*.mcap")
        whole.replace(file)
    except OSError as error:
        raise BagError(f"{file}: cannot write: {error.strerror}") from None
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _copy(source: Path, folder: Path, losses: Losses, may_be_empty: bool = False) -> int:
    """Copy what can be read; say how many messages that is."""
    left = read_messages(source, losses)
    undecodable = Counter[str]()
    first = next((message for message in left if _is_sound(message, undecodable)), None)
    # A recorder that was killed at once left a file that never had anything in it.
    if first is None and not (may_be_empty and set(+losses.causes) == {NO_END}):
        raise BagError(f"{source}: nothing is left that could be recovered")
    known: set[str] = set()
    with BagWriter(folder) as bag:
        message: BagMessage | None = first
        while message is not None:
            if message.topic not in known and message.definition is not None:
                known.add(message.topic)
                bag.add_topic_of(*message.definition)
            bag.write(message.topic, message.data, message.log_time_ns, message.publish_time_ns)
            message = next((m for m in left if _is_sound(m, undecodable)), None)
        losses.causes.update(undecodable)
        if losses:
            bag.add_metadata(RECOVERED, losses.as_metadata())
        return bag.messages


def _is_sound(message: BagMessage, undecodable: Counter[str]) -> bool:
    """Whether a message can be decoded, or nobody here knows its type."""
    if message.msgtype in typestore().types:
        try:
            message.decode()
        except BagError:
            undecodable[f"undecodable {message.topic.rpartition('/')[2]}"] += 1
            return False
    return True
