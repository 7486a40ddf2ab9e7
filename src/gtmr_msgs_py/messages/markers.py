# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What RViz and Foxglove draw, as visualization_msgs: tower, shells, vehicle and plan."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from numpy.typing import ArrayLike, NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from gtmr_model import Tower, Vehicle
from gtmr_model.dynamics import ATTITUDE, POSITION, ROTORS
from gtmr_msgs_py.contract import MAP
from gtmr_msgs_py.wire import attitude, stamps

DRAWN_HEIGHT_M = 20.0
"""Height to which tower and shells are drawn; the model's tower has no end [m]."""
DRAWN_HUB_RADIUS_M = 0.03
"""Least radius of a drawn propeller disc [m], for vehicles that do not tell theirs."""
DRAWN_THRUST_M_PER_N = 0.06
"""Length of a thrust arrow per thrust [m/N]; at hover about the diameter of a propeller."""
DRAWN_TEXT_M = 0.2
"""Height of letters, and of the text above the vehicle [m]."""
DRAWN_STAGE_HEIGHT_M = 0.03
"""Height of the collar that stands for one stage of the horizon [m]."""


@dataclass(frozen=True)
class Color:
    """Red, green, blue and opacity, 0 to 1."""

    r: float
    g: float
    b: float
    a: float = 1.0


CONCRETE = Color(0.75, 0.75, 0.72)
FORBIDDEN = Color(0.75, 0.1, 0.2, 0.15)
BODY = Color(0.15, 0.15, 0.18)
THRUST = Color(0.902, 0.624, 0.0)
ALARM = Color(0.9, 0.1, 0.1)
CLOCKWISE = Color(0.0, 0.62, 0.451, 0.8)
COUNTER_CLOCKWISE = Color(0.8, 0.475, 0.655, 0.8)
MODE_COLORS = {
    "nominal": Color(0.835, 0.369, 0.0),
    "robust": Color(0.0, 0.447, 0.698),
    "offset_free": Color(0.0, 0.62, 0.451),
}
"""Colour of what belongs to a controller mode, the same as in the report."""

NAMESPACES = (
    "tower",
    "d_min",
    "tightened",
    "tightened_stages",
    "plan",
    "body",
    "arms",
    "propellers",
    "thrust",
    "guard",
)
"""Every namespace that the nodes publish; what a view shows or hides by itself."""


def encode(stamp_ns: int, markers: Iterable[Marker], world_frame: str = MAP) -> MarkerArray:
    """Put markers, of the world frame, into one message with a stamp [ns]."""
    stamped = list(markers)
    for marker in stamped:
        marker.header.frame_id = world_frame
        marker.header.stamp = stamps.encode(stamp_ns)
    return MarkerArray(markers=stamped)


def tower(tower: Tower) -> list[Marker]:
    """Draw the tower and the shell at d_min that the vehicle must stay out of."""
    radius = tower.radius_m
    return [
        _upright_cylinder("tower", radius, CONCRETE),
        _upright_cylinder("d_min", radius + tower.min_clearance_m, FORBIDDEN),
    ]


def tightened_shells(
    tower: Tower, margins_m: ArrayLike, heights_m: ArrayLike, mode: str
) -> list[Marker]:
    """Draw what the plan stays out of, in the colour of the mode.

    A shell of full height stands for the largest margin alpha_p + alpha_g [m], and a collar at the
    planned height of each stage [m] for the margin of that stage, both of shape (N + 1,); collars
    of different margins lie in each other like rings.
    """
    color = MODE_COLORS[mode]
    radii = tower.radius_m + tower.min_clearance_m + np.asarray(margins_m, dtype=float)
    shell = _upright_cylinder("tightened", radii.max(), _faded(color, 0.1))
    collars = []
    for i, (radius, height) in enumerate(zip(radii, np.asarray(heights_m), strict=True)):
        size = (2.0 * radius, 2.0 * radius, DRAWN_STAGE_HEIGHT_M)
        collar = _marker("tightened_stages", i, Marker.CYLINDER, _faded(color, 0.1), size)
        collar.pose.position.z = float(height)
        collars.append(collar)
    return [shell, *collars]


def line(namespace: str, positions: ArrayLike, color: Color, width_m: float) -> Marker:
    """Draw a line through positions in the world frame [m], shape (n, 3)."""
    strip = _marker(namespace, 0, Marker.LINE_STRIP, color, (width_m, 0.0, 0.0))
    strip.points = [_point(p) for p in np.asarray(positions, dtype=float)]
    return strip


def plan(positions: ArrayLike, mode: str) -> list[Marker]:
    """Draw planned positions in the world frame [m], shape (N + 1, 3), in the mode's colour."""
    return [line("plan", positions, MODE_COLORS[mode], 0.02)]


def vehicle(vehicle: Vehicle, x: ArrayLike) -> list[Marker]:
    """Draw body, arms and propeller discs, tilted as they are and coloured by their spin.

    State [p, eta, ...]: world frame [m], [rad]. Of a whole state, which ends with the rotor speeds
    [Hz], thrust is drawn too, as arrows from the hubs.
    """
    state = np.asarray(x, dtype=float)
    position, orientation = state[POSITION], attitude.encode(state[ATTITUDE])
    body_to_world = attitude.rotation(orientation)

    body = _marker("body", 0, Marker.CUBE, BODY, (0.16, 0.16, 0.07))
    body.pose = Pose(position=_point(position), orientation=orientation)
    arms = _marker("arms", 0, Marker.LINE_LIST, BODY, (0.02, 0.0, 0.0))
    discs, thrusts = [], []
    thrust_n = vehicle.force_coefficient_n_per_hz2 * state[ROTORS] ** 2
    for i, rotor in enumerate(vehicle.rotors):
        hub = position + body_to_world @ np.asarray(rotor.position_m)
        arms.points += [_point(position), _point(hub)]
        color = CLOCKWISE if rotor.spin == "cw" else COUNTER_CLOCKWISE
        diameter = 2.0 * max(vehicle.rotor_radius_m, DRAWN_HUB_RADIUS_M)
        disc = _marker("propellers", i, Marker.CYLINDER, color, (diameter, diameter, 0.01))
        up = body_to_world @ rotor.axis
        disc.pose = Pose(position=_point(hub), orientation=_z_to(up))
        discs.append(disc)
        if thrust_n.size:
            # Between two points, scale is shaft diameter, head diameter, head length.
            arrow = _marker("thrust", i, Marker.ARROW, THRUST, (0.018, 0.045, 0.06))
            tip = hub + DRAWN_THRUST_M_PER_N * thrust_n[i] * up
            arrow.points = [_point(hub), _point(tip)]
            thrusts.append(arrow)
    return [body, arms, *discs, *thrusts]


def guard(position: ArrayLike, cause: str) -> list[Marker]:
    """Write above the vehicle, at its position in the world frame [m], why the guard is in charge.

    Without a cause it is not in charge, and the text is removed.
    """
    text = _marker("guard", 0, Marker.TEXT_VIEW_FACING, ALARM, (0.0, 0.0, DRAWN_TEXT_M))
    text.action = Marker.ADD if cause else Marker.DELETE
    text.text = f"guard: {cause}"
    text.pose.position = _point(np.asarray(position, dtype=float))
    text.pose.position.z += DRAWN_TEXT_M
    return [text]


def _faded(color: Color, opacity: float) -> Color:
    return replace(color, a=opacity)


def _upright_cylinder(namespace: str, radius_m: float, color: Color) -> Marker:
    size = (2.0 * radius_m, 2.0 * radius_m, DRAWN_HEIGHT_M)
    marker = _marker(namespace, 0, Marker.CYLINDER, color, size)
    marker.pose.position.z = 0.5 * DRAWN_HEIGHT_M
    return marker


def _marker(
    namespace: str, number: int, shape: int, color: Color, size: tuple[float, float, float]
) -> Marker:
    marker = Marker(ns=namespace, id=number, type=shape, action=Marker.ADD)
    marker.color = ColorRGBA(r=color.r, g=color.g, b=color.b, a=color.a)
    marker.scale = Vector3(x=float(size[0]), y=float(size[1]), z=float(size[2]))
    return marker


def _point(position: NDArray[np.float64]) -> Point:
    return Point(x=float(position[0]), y=float(position[1]), z=float(position[2]))


def _z_to(axis: NDArray[np.float64]) -> Quaternion:
    """Shortest rotation that turns the z axis into a unit axis that does not point down."""
    x, y, z = (float(component) for component in axis)
    q = np.array([-y, x, 0.0, 1.0 + z])
    q /= np.linalg.norm(q)
    return Quaternion(x=float(q[0]), y=float(q[1]), z=float(q[2]), w=float(q[3]))
