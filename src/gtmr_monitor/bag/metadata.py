# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The metadata.yaml of rosbag2: the files of a bag, its topics, their quality of service."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import yaml

METADATA_VERSION = 9
"""Version of rosbag2's metadata.yaml, Jazzy's."""
ROS_DISTRO = "jazzy"
"""Whose message definitions the bag carries."""
FILE_NAME = "metadata.yaml"
"""Beside the MCAP files of a bag."""
DRAFT_NAME = "metadata.yaml.tmp"
"""Its name while it is being written."""
MENDING_NAME = ".mending"
"""Folder in which a file that was torn off is made whole."""
LEFTOVERS = (FILE_NAME, DRAFT_NAME, MENDING_NAME)
"""What a recorder may leave in its folder beside MCAP files."""
_MOST_BYTES = 10_000_000
"""No metadata.yaml is as large as that [bytes]."""

_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class OfferedQos:
    """Quality of service of a topic's publishers, as the bag tells it to a player."""

    depth: int = 10
    """How many messages the publisher keeps."""
    reliability: Literal["reliable", "best_effort"] = "reliable"
    """Whether messages are sent again until they arrive."""
    durability: Literal["volatile", "transient_local"] = "volatile"
    """Whether late subscribers get the last messages."""

    def profile(self) -> dict[str, Any]:
        """Return one entry of ``offered_qos_profiles``, metadata version 9."""
        return {
            "history": "keep_last",
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
            "avoid_ros_namespace_conventions": False,
        }


@dataclass(frozen=True)
class Contents:
    """The content of a bag according to its metadata.yaml."""

    files: tuple[str, ...]
    """Names of its MCAP files, in order."""
    messages: int
    """How many messages there are in all of them."""
    topics: Mapping[str, int]
    """How many there are, by topic."""


@dataclass(frozen=True)
class FileTotals:
    """The content of one MCAP file of a bag."""

    name: str
    """Of the file."""
    start_ns: int
    """When its first message was received, Unix time [ns]; 0 without messages."""
    end_ns: int
    """When its last message was received, Unix time [ns]."""
    counts: Mapping[str, int]
    """How many messages there are, by topic."""

    @property
    def messages(self) -> int:
        """How many there are of all topics."""
        return sum(self.counts.values())


def profiles_in(text: str) -> list[dict[str, Any]]:
    """Read the quality of service in a channel; the default if it is not as Jazzy writes it."""
    try:
        profiles = yaml.safe_load(text)
    except yaml.YAMLError:
        profiles = None
    expected = set(OfferedQos().profile())
    if isinstance(profiles, list) and all(
        isinstance(each, dict) and set(each) == expected for each in profiles
    ):
        return profiles
    return [OfferedQos().profile()]


def read_contents(folder: Path) -> Contents | None:
    """Read what the metadata.yaml of a bag says; None if there is none.

    Raises ValueError if it cannot be read, or is not what rosbag2 writes.
    """
    path = folder / FILE_NAME
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ValueError(f"{path}: too large")
        bag = yaml.safe_load(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        topics = bag["topics_with_message_count"]
        return Contents(
            tuple(str(name) for name in bag["relative_file_paths"]),
            int(bag["message_count"]),
            {str(t["topic_metadata"]["name"]): int(t["message_count"]) for t in topics},
        )
    except FileNotFoundError:
        return None
    except Exception as error:  # a broken file makes YAML raise anything
        raise ValueError(f"{path}: {error}") from None
