# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The inspection reference: a helix around the tower at the preferred offset, eq. (2)."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
from pydantic import Field, field_validator

from gtmr_model.reference import ReferencePath
from gtmr_model.tower import Tower
from gtmr_model.yaml_file import ConfigError


class Helix(ReferencePath):
    """A helix about the tower at constant offset, speed and climb rate."""

    kind: str = "helix"
    """Which path."""
    offset_m: float = Field(0.35, gt=0.0)
    """d_ref, distance to the tower's surface [m] (Table I)."""
    speed_m_s: float = 0.5
    """Tangential speed, counter-clockwise seen from above, clockwise if negative, never 0 [m/s];
    assumed."""
    climb_m_s: float = 0.05
    """Vertical speed [m/s]; assumed."""
    start_height_m: float = 2.0
    """Height at t = 0 [m]; assumed."""
    start_angle_rad: float = 0.0
    """Angle about the tower at t = 0, from the world's x axis [rad]."""

    @classmethod
    def required(cls, path: ReferencePath) -> Helix:
        """Return a reference that must be a helix, or raise a ConfigError."""
        if not isinstance(path, cls):
            raise ConfigError(f"helix.kind = {path.kind!r}: for this it must be 'helix'")
        return path

    @field_validator("speed_m_s")
    @classmethod
    def _goes_around(cls, speed_m_s: float) -> float:
        if speed_m_s == 0.0:
            raise ValueError(
                "a helix that stands still has no turn: above 0 is counter-clockwise, below 0 "
                "clockwise"
            )
        return speed_m_s

    def position(self, t: Any, tower: Tower) -> Any:
        """On the cylinder of radius R + d_ref."""
        radius, angle = tower.radius_m + self.offset_m, self._angle(t, tower)
        return ca.vertcat(
            radius * ca.cos(angle),
            radius * ca.sin(angle),
            self.start_height_m + self.climb_m_s * t,
        )

    def yaw(self, t: Any, tower: Tower) -> Any:
        """Facing the tower."""
        return self._angle(t, tower) + math.pi

    def _angle(self, t: Any, tower: Tower) -> Any:
        rate = self.speed_m_s / (tower.radius_m + self.offset_m)
        return self.start_angle_rad + rate * t
