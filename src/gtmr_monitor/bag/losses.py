# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is missing in a bag, found while it is read."""

import json
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

RECOVERED = "gtmr_recovered"
"""Name of the metadata in a recovered bag that say what could not be recovered."""
TORN_OFF = "torn off"
"""That of a bag that was recovered."""
CHUNK = "damaged chunk"
RECORD = "damaged record"
INDEX = "damaged index"
NO_END = "no end"
"""The writer was killed, or the file was cut off."""
METADATA = "wrong metadata.yaml"
MISSING_FILE = "missing file"
UNREADABLE_FILE = "unreadable file"
CHECKSUM = "wrong checksum"
DEFINITION = "message of an unknown topic"


@dataclass
class TopicLoss:
    """How many messages of a topic cannot be read, and where they were."""

    head: int = 0
    """Before the first that is left."""
    inside: int = 0
    """In between, or it is not known where."""
    tail: int = 0
    """After the last that is left."""

    @property
    def total(self) -> int:
        """All of them."""
        return self.head + self.inside + self.tail


@dataclass
class Losses:
    """What a bag lacks; filled while its messages are read, and true once all of them are."""

    causes: Counter[str] = field(default_factory=Counter)
    """What is wrong, and how often."""
    topics: dict[str, TopicLoss] = field(default_factory=lambda: defaultdict(TopicLoss))
    """What is lost, by topic."""
    recovered: bool = False
    """Whether the bag was made of what was left of another."""
    _seen: set[str] = field(default_factory=set)
    _recovered: dict[str, TopicLoss] = field(default_factory=dict)

    @property
    def messages(self) -> dict[str, int]:
        """How many messages are lost, by topic that lacks any."""
        return {topic: loss.total for topic, loss in sorted(self.topics.items()) if loss.total}

    @property
    def has_end(self) -> bool:
        """Whether every file was closed by its writer."""
        return not self.causes[NO_END]

    def __str__(self) -> str:
        """Say it in a few words."""
        lost = sum(self.messages.values())
        words = [cause if n == 1 else f"{n} × {cause}" for cause, n in self.causes.items() if n]
        return ", ".join(words + ([f"{lost} messages lost"] if lost else []))

    def __bool__(self) -> bool:
        """Whether anything is known to be wrong."""
        return bool(+self.causes or self.messages)

    def add_file(self, lost: Mapping[str, TopicLoss], read: Mapping[str, int]) -> None:
        """Take in what one file lacks and how much was read of it, by topic; files in order."""
        for topic in {*lost, *read}:
            all_of_it, of_file = self.topics[topic], lost.get(topic, TopicLoss())
            if not read.get(topic):
                all_of_it.tail += of_file.total
                continue
            between = all_of_it.tail + of_file.head
            if topic in self._seen:
                all_of_it.inside += between
            else:
                all_of_it.head += between
                self._seen.add(topic)
            all_of_it.inside += of_file.inside
            all_of_it.tail = of_file.tail

    def finish(self) -> None:
        """Add what recovered files say, once all files are read."""
        for topic, loss in self._recovered.items():
            all_of_it = self.topics[topic]
            all_of_it.head += loss.head
            all_of_it.inside += loss.inside
            all_of_it.tail += loss.tail
        self._recovered = {}
        self.causes = +self.causes

    def as_metadata(self) -> dict[str, str]:
        """Give it as metadata of an MCAP file."""
        topics = {topic: asdict(loss) for topic, loss in self.topics.items() if loss.total}
        causes = {TORN_OFF if c == NO_END else c: n for c, n in self.causes.items() if n}
        return {"causes": json.dumps(causes), "topics": json.dumps(topics)}

    def add_metadata(self, metadata: Mapping[str, str]) -> None:
        """Take over what a recovered file says of the bag that it was made of."""
        try:
            causes = json.loads(metadata["causes"])
            topics = json.loads(metadata["topics"])
            self.recovered = True
            self.causes.update({str(cause): int(n) for cause, n in causes.items()})
            for topic, loss in topics.items():
                self._recovered[topic] = TopicLoss(**{k: int(n) for k, n in loss.items()})
        except (ValueError, KeyError, TypeError, AttributeError):
            self.causes[RECORD] += 1


class FileTally:
    """The messages of one file by topic: what is there, and by their numbers, what is not."""

    def __init__(self) -> None:
        self.read: Counter[str] = Counter()
        self._first: dict[str, int] = {}
        self._last: dict[str, int] = {}
        self._numbered: dict[str, bool] = {}

    def count(self, topic: str, number: int) -> None:
        """Take in a message and its number in its topic, which grows by one where it is kept."""
        if topic not in self._first:
            self._first[topic], self._numbered[topic] = number, True
        elif number <= self._last[topic]:
            self._numbered[topic] = False
        self._last[topic] = number
        self.read[topic] += 1

    def losses(self, expected: Mapping[str, int] | None, damaged: bool) -> dict[str, TopicLoss]:
        """Say what is lost, by how many messages the file should have, None if nothing tells.

        Then their numbers tell, if the file is damaged: others number what they have not heard.
        """
        lost = {}
        for topic in {*self.read, *(expected or {})}:
            head, inside = self._by_number(topic)
            if expected is None:
                loss = TopicLoss(head, inside) if damaged else TopicLoss()
            else:
                total = max(0, expected.get(topic, 0) - self.read[topic])
                head = min(head, total) if self.read[topic] else 0
                # Without sequence numbers it is not known where they were.
                where_unknown = topic in self.read and not self._is_numbered(topic)
                inside = total if where_unknown else min(inside, total - head)
                loss = TopicLoss(head, inside, total - head - inside)
            if loss.total:
                lost[topic] = loss
        return lost

    def _is_numbered(self, topic: str) -> bool:
        return self._numbered[topic]

    def _by_number(self, topic: str) -> tuple[int, int]:
        if topic not in self.read or not self._is_numbered(topic):
            return 0, 0
        first, last = self._first[topic], self._last[topic]
        return first, last - first + 1 - self.read[topic]
