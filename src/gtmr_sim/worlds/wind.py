# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Wind as a velocity field: profile, turbulence, flow around the tower and the wake behind it."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Annotated, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gtmr_model import ConfigError, Tower, Vehicle, YamlModel
from gtmr_model.dynamics import ATTITUDE, RATE, ROTORS, VELOCITY, rotation
from gtmr_sim.noise import ColouredNoise, dryden

Array = NDArray[np.float64]
Amount = Annotated[float, Field(ge=0.0)]


class Wind(YamlModel):
    """Wind that acts by the vehicle's drag on its velocity relative to the air."""

    speed_m_s: Amount | None = None
    """Speed of the mean wind at the reference height, far from the tower [m/s]. Left out: that
    whose drag on the hovering vehicle is w_b of zeta, so that no force is counted twice. A number
    takes the place of w_b; its direction comes from the seed."""
    reference_height_m: float = Field(10.0, gt=0.0)
    """Height of that speed [m]."""
    profile_exponent: Amount = 0.0
    """Exponent of the mean wind's growth with height [-], 0 is none: the power law, with 1/7 over
    open land (Justus and Mikhail, Geophys. Res. Lett. 1976)."""
    turbulence_m_s: Amount = 0.0
    """Standard deviation of the horizontal turbulence [m/s]: Dryden at low altitude, carried past
    by the mean wind (MIL-F-8785C, Sec. 3.7). The tower does not change it."""
    flow_around_tower: bool = False
    """Whether the mean wind flows around the tower: potential flow around a cylinder."""
    wake: bool = False
    """Whether it is slower in the tower's wake: Powles's model of a tower's shadow (Wind
    Engineering 7, 1983), as AeroDyn has it, at most to a standstill."""
    tower_drag_coefficient: Amount = 0.7
    """C_d of the tower in its wake [-]: Roshko (J. Fluid Mech. 10, 1961), smooth, at Reynolds
    numbers above 3.5e6; fewer give less."""
    blade_drag_n_s_per_m_hz: Amount = 0.0
    """In-plane drag of a rotor per speed relative to the air and rotor speed [N s/(m Hz)]: lumped
    blade drag (Martin and Salaun, ICRA 2010), 5.07e-4 in RotorS (8.06428e-5 N s^2/(m rad))."""


def far_wind(wind: Wind, zeta: Array, vehicle: Vehicle, rng: np.random.Generator) -> Array:
    """Mean wind far from the tower, at the reference height, world frame [m/s], shape (3,)."""
    direction = rng.uniform(0.0, math.tau)
    if wind.speed_m_s is None:
        drag = hover_drag(wind, zeta, vehicle)
        if drag[0, 0] == 0.0:
            raise ConfigError("drag_n_s_per_m = 0: a wind field needs a vehicle with drag")
        return np.asarray(np.linalg.solve(drag, zeta[6:9]))
    return wind.speed_m_s * np.array([math.cos(direction), math.sin(direction), 0.0])


def hover_drag(wind: Wind, zeta: Array, vehicle: Vehicle) -> Array:
    """Force per air velocity on the level vehicle at nominal hover [N s/m], shape (3, 3)."""
    drag = (1.0 + zeta[5]) * vehicle.drag_n_s_per_m * np.eye(3)
    for rotor, speed in zip(vehicle.rotors, vehicle.hover_rotor_speeds_hz, strict=True):
        in_plane = np.eye(3) - np.outer(rotor.axis, rotor.axis)
        drag = drag + wind.blade_drag_n_s_per_m_hz * speed * in_plane
    return drag


def hover_force(drag: Array, air_m_s: Array) -> Array:
    """Force of the wind by that drag [N] at air velocities [m/s], both of shape (..., 3)."""
    force: Array = sum(drag[:, i] * air_m_s[..., i, None] for i in range(3))  # type: ignore[assignment]
    return force


def around_tower(wind: Wind, far: Array, position: Array, tower: Tower) -> Array:
    """Mean wind at a position [m] for a horizontal far wind, world frame [m/s], shape (3,).

    The vertical part of the wind passes the tower as it is.
    """
    speed = math.hypot(far[0], far[1])
    if speed == 0.0 or not (wind.flow_around_tower or wind.wake):
        return far
    along = np.array([far[0], far[1], 0.0]) / speed
    across = np.array([-along[1], along[0], 0.0])
    # In tower radii; inside the tower as on its surface.
    x, y = (_product(axis, position) / tower.radius_m for axis in (along, across))
    r = math.hypot(x, y)
    if r < 1.0:
        x, y, r = (x / r, y / r, 1.0) if r > 0.0 else (-1.0, 0.0, 1.0)
    u, v = 1.0, 0.0
    if wind.flow_around_tower:
        u, v = 1.0 - (x * x - y * y) / r**4, -2.0 * x * y / r**4
    left = 1.0 - wake_deficit(wind.tower_drag_coefficient, x, y) if wind.wake else 1.0
    flow: Array = speed * left * (u * along + v * across)
    flow[2] = far[2]
    return flow


def _product(a: Array, b: Array) -> float:
    """Horizontal part of the scalar product, its second term not rounded on its own.

    So do processors with fused operations, and the compiled loop.
    """
    a_x, a_y, b_x, b_y = map(float, (*a[:2], *b[:2]))
    if not math.isfinite(a_x * b_x + a_y * b_y):
        return math.nan
    return float(Fraction(a_y) * Fraction(b_y) + Fraction(a_x * b_x))


def wake_deficit(drag_coefficient: float, x: float, y: float) -> float:
    """Share of the wind that is missing behind a tower (Powles 1983) [-].

    x downwind and y across the wind are in tower radii from its axis.
    """
    width = (x * x + y * y) ** 0.25
    if x <= 0.0 or abs(y) >= width:
        return 0.0
    return min(1.0, drag_coefficient / width * math.cos(0.5 * math.pi * y / width) ** 2)


class WindField:
    """The wind of a flight, one sample every hold period [s], with its own random numbers.

    The turbulence is that at the flight's start height [m].
    """

    def __init__(
        self,
        wind: Wind,
        zeta: Array,
        vehicle: Vehicle,
        tower: Tower,
        rng: np.random.Generator,
        hold_s: float,
        height_m: float,
    ) -> None:
        self.wind, self.tower = wind, tower
        self.far = far_wind(wind, zeta, vehicle, rng)
        """Mean wind far from the tower, at the reference height, world frame [m/s], (3,)."""
        speed = math.hypot(self.far[0], self.far[1])
        self.along: Array = self.far[:2] / speed if speed > 0.0 else np.array([1.0, 0.0])
        """Its horizontal direction, shape (2,)."""
        self.turbulence: ColouredNoise | None = None
        """Along it, across it and up [m/s]."""
        if wind.turbulence_m_s > 0.0 and speed > 0.0:
            filters = dryden(wind.turbulence_m_s, speed, height_m)
            self.turbulence = ColouredNoise(filters, rng, hold_s)

    def __call__(self, position: Array) -> Array:
        """Give the wind at a position [m] from now on, world frame [m/s], both of shape (3,)."""
        wind, along = self.wind, self.along
        height = max(float(position[2]), 0.0) / wind.reference_height_m
        grown = height**wind.profile_exponent if wind.profile_exponent > 0.0 else 1.0
        flow = around_tower(wind, grown * self.far, position, self.tower)
        if self.turbulence is not None:
            u, v, w = self.turbulence.draw(1)[0]
            flow = flow + np.array([along[0] * u - along[1] * v, along[1] * u + along[0] * v, w])
        return flow


def wind_effect(wind: Wind, x: Any, zeta: Any, air: Any, vehicle: Vehicle) -> tuple[Any, Any]:
    """Force, world frame [N], and torque, body frame [N m], beyond eq. (3), symbolic.

    Air is the wind's velocity, world frame [m/s], shape (3,). What eq. (3) has of it already, w_b,
    is taken back; the drag of the vehicle's own motion it has, but for the blades'.
    """
    to_world = rotation(x[ATTITUDE])
    force = (1.0 + zeta[5]) * vehicle.drag_n_s_per_m * air - zeta[6:9]
    relative = to_world.T @ (x[VELOCITY] - air)
    blades, torque = ca.SX(3, 1), ca.SX(3, 1)
    if wind.blade_drag_n_s_per_m_hz > 0.0:
        for i, rotor in enumerate(vehicle.rotors):
            arm, axis = ca.DM(rotor.position_m), ca.DM(rotor.axis)
            hub = relative + ca.cross(x[RATE], arm)
            in_plane = hub - axis * ca.dot(axis, hub)
            drag = -wind.blade_drag_n_s_per_m_hz * x[ROTORS][i] * in_plane
            blades += drag
            torque += ca.cross(arm, drag)
    return force + to_world @ blades, torque
