# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The quality of service that a bag tells to a player."""

from dataclasses import dataclass
from typing import Any, Literal

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
