# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Whether the nodes of a flight were told of the same tower: each has it from its parameters."""

from collections.abc import Mapping
from typing import Any

NAMES = ("tower.radius_m", "tower.min_clearance_m")
"""The parameters that say where the vehicle may not be [m]."""


class TowerAgreement:
    """What each node takes for the tower."""

    def __init__(self) -> None:
        self._known: dict[str, dict[str, float]] = {name: {} for name in NAMES}

    def take(self, node: str, parameters: Mapping[str, Any]) -> None:
        """Take in some parameters of a node, by name."""
        for name, values in self._known.items():
            if name in parameters:
                values[node] = float(parameters[name])

    @property
    def disagreements(self) -> list[str]:
        """One sentence for each parameter that has several values, naming nodes and values."""
        return [
            f"{name} is "
            + ", ".join(f"{value:g} m in {node}" for node, value in sorted(values.items()))
            for name, values in self._known.items()
            if len(set(values.values())) > 1
        ]
