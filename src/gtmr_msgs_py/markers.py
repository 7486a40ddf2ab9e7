"""What RViz and Foxglove draw, as visualization_msgs: tower, shells, vehicle and plan."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from numpy.typing import ArrayLike, NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from gtmr_model import Tower, Vehicle
from gtmr_model.dynamics import ATTITUDE, POSITION
from gtmr_msgs_py import attitude, stamps
from gtmr_msgs_py.topics import MAP

DRAWN_HEIGHT_M = 20.0
"""Height to which tower and shells are drawn; the model's tower has no end [m]."""
DRAWN_PROPELLER_RADIUS_M = 0.13
"""Radius of a drawn propeller disc [m]."""


@dataclass(frozen=True)
class Color:
    """Red, green, blue and opacity, 0 to 1."""

    r: float
    g: float
    b: float
    a: float = 1.0


CONCRETE = Color(0.75, 0.75, 0.72)
FORBIDDEN = Color(0.85, 0.2, 0.15, 0.25)
BODY = Color(0.15, 0.15, 0.18)
CLOCKWISE = Color(0.9, 0.55, 0.1, 0.9)
COUNTER_CLOCKWISE = Color(0.2, 0.55, 0.85, 0.9)
MODE_COLORS = {"nominal": Color(0.85, 0.4, 0.1), "robust": Color(0.1, 0.45, 0.8)}
"""Colour of what belongs to a controller mode."""


def encode(stamp_ns: int, markers: Iterable[Marker]) -> MarkerArray:
    """Put markers into one message.

    Parameters
    ----------
    stamp_ns : int
        [ns].
    markers : iterable of visualization_msgs.msg.Marker
        In the world frame.

    Returns
    -------
    visualization_msgs.msg.MarkerArray
    """
    stamped = list(markers)
    for marker in stamped:
        marker.header.frame_id = MAP
        marker.header.stamp = stamps.encode(stamp_ns)
    return MarkerArray(markers=stamped)


def tower(tower: Tower) -> list[Marker]:
    """Draw the tower and the shell at d_min that the vehicle must stay out of.

    Parameters
    ----------
    tower : Tower
        On the z axis of the world frame.

    Returns
    -------
    list of visualization_msgs.msg.Marker
    """
    radius = tower.radius_m
    return [
        _upright_cylinder("tower", radius, CONCRETE),
        _upright_cylinder("d_min", radius + tower.min_clearance_m, FORBIDDEN),
    ]


def tightened_shell(tower: Tower, margin_m: float, mode: str) -> list[Marker]:
    """Draw the shell that the plan stays out of, in the colour of the mode.

    Parameters
    ----------
    tower : Tower
        On the z axis of the world frame.
    margin_m : float
        The largest alpha_p + alpha_g of the plan [m].
    mode : str
        ``nominal`` or ``robust``.

    Returns
    -------
    list of visualization_msgs.msg.Marker
    """
    radius = tower.radius_m + tower.min_clearance_m + margin_m
    color = MODE_COLORS[mode]
    return [_upright_cylinder("tightened", radius, Color(color.r, color.g, color.b, 0.2))]


def plan(positions: ArrayLike, mode: str) -> list[Marker]:
    """Draw the planned path, in the colour of the mode.

    Parameters
    ----------
    positions : array_like, shape (N + 1, 3)
        World frame [m].
    mode : str
        ``nominal`` or ``robust``.

    Returns
    -------
    list of visualization_msgs.msg.Marker
    """
    line = _marker("plan", 0, Marker.LINE_STRIP, MODE_COLORS[mode], (0.02, 0.0, 0.0))
    line.points = [_point(p) for p in np.asarray(positions, dtype=float)]
    return [line]


def vehicle(vehicle: Vehicle, x: ArrayLike) -> list[Marker]:
    """Draw body, arms and propeller discs, tilted as they are and coloured by their spin.

    Parameters
    ----------
    vehicle : Vehicle
        Where the rotors are.
    x : array_like, shape (6,) or longer
        State [p, eta, ...]: world frame [m], [rad].

    Returns
    -------
    list of visualization_msgs.msg.Marker
    """
    state = np.asarray(x, dtype=float)
    position, orientation = state[POSITION], attitude.encode(state[ATTITUDE])
    body_to_world = attitude.rotation(orientation)

    body = _marker("body", 0, Marker.CUBE, BODY, (0.16, 0.16, 0.07))
    body.pose = Pose(position=_point(position), orientation=orientation)
    arms = _marker("arms", 0, Marker.LINE_LIST, BODY, (0.02, 0.0, 0.0))
    discs = []
    for i, rotor in enumerate(vehicle.rotors):
        hub = position + body_to_world @ np.asarray(rotor.position_m)
        arms.points += [_point(position), _point(hub)]
        color = CLOCKWISE if rotor.spin == "cw" else COUNTER_CLOCKWISE
        diameter = 2.0 * DRAWN_PROPELLER_RADIUS_M
        disc = _marker("propellers", i, Marker.CYLINDER, color, (diameter, diameter, 0.01))
        disc.pose = Pose(position=_point(hub), orientation=_z_to(body_to_world @ rotor.axis))
        discs.append(disc)
    return [body, arms, *discs]


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
