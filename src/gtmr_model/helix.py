# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The inspection reference: a helix round the tower at the preferred offset, eq. (2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from gtmr_model.dynamics import POSITION, RATE, ROTORS, VELOCITY, YAW
from gtmr_model.tower import Tower
from gtmr_model.vehicle import Vehicle
from gtmr_model.yaml_model import YamlModel


@dataclass(frozen=True)
class Reference:
    """The helix at n instants, world frame."""

    position: NDArray[np.float64]
    """[m], shape (n, 3)."""
    velocity: NDArray[np.float64]
    """[m/s], shape (n, 3)."""
    acceleration: NDArray[np.float64]
    """[m/s^2], shape (n, 3)."""
    yaw: NDArray[np.float64]
    """Facing the tower; grows without wrapping round [rad], shape (n,)."""
    yaw_rate: float
    """[rad/s]."""


class Helix(YamlModel):
    """A helix about the tower at constant offset, speed and climb rate."""

    offset_m: float = Field(0.35, gt=0.0)
    """d_ref, distance to the tower's surface [m] (Table I)."""
    speed_m_s: float = 0.5
    """Tangential speed, counter-clockwise seen from above [m/s]; assumed."""
    climb_m_s: float = 0.05
    """Vertical speed [m/s]; assumed."""
    start_height_m: float = 2.0
    """Height at t = 0 [m]; assumed."""
    start_angle_rad: float = 0.0
    """Angle about the tower at t = 0, from the world's x axis [rad]."""

    def at(self, time_s: ArrayLike, tower: Tower) -> Reference:
        """Sample the helix.

        Parameters
        ----------
        time_s : array_like, shape (n,)
            Instants [s].
        tower : Tower
            What the helix goes round.

        Returns
        -------
        Reference
            Position, velocity, acceleration, yaw at every instant.
        """
        t = np.atleast_1d(np.asarray(time_s, dtype=float))
        radius = tower.radius_m + self.offset_m
        rate = self.speed_m_s / radius
        angle = self.start_angle_rad + rate * t
        outward = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(t)], axis=1)
        tangent = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(t)], axis=1)
        position = radius * outward
        position[:, 2] = self.start_height_m + self.climb_m_s * t
        velocity = self.speed_m_s * tangent
        velocity[:, 2] = self.climb_m_s
        return Reference(
            position=position,
            velocity=velocity,
            acceleration=-self.speed_m_s * rate * outward,
            yaw=angle + np.pi,
            yaw_rate=rate,
        )

    def facing(self, time_s: float, tower: Tower) -> float:
        """Yaw that faces the tower from the helix at one instant.

        Parameters
        ----------
        time_s : float
            Instant [s].
        tower : Tower
            What the helix goes round.

        Returns
        -------
        float
            Grows without wrapping round [rad].
        """
        rate = self.speed_m_s / (tower.radius_m + self.offset_m)
        return self.start_angle_rad + rate * time_s + math.pi

    def initial_state(self, tower: Tower, vehicle: Vehicle) -> NDArray[np.float64]:
        """State that flies along the helix at t = 0, level and with hover rotor speeds.

        Parameters
        ----------
        tower : Tower
            What the helix goes round.
        vehicle : Vehicle
            Gives the number of rotors and their hover speeds.

        Returns
        -------
        NDArray, shape (12 + N_p,)
        """
        start = self.at(0.0, tower)
        x = np.zeros(vehicle.n_x)
        x[POSITION] = start.position[0]
        x[YAW] = start.yaw[0]
        x[VELOCITY] = start.velocity[0]
        x[RATE] = [0.0, 0.0, start.yaw_rate]
        x[ROTORS] = vehicle.hover_rotor_speeds_hz
        return x
