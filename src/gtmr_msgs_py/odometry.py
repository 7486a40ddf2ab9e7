# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""Position, attitude, velocity and body rates as nav_msgs/Odometry.

The state has its velocity in the world frame, the message in the child frame: it is rotated here
and nowhere else.
"""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Vector3
from nav_msgs.msg import Odometry
from numpy.typing import ArrayLike, NDArray

from gtmr_model.dynamics import ATTITUDE, POSITION, RATE, VELOCITY
from gtmr_msgs_py import attitude, stamps
from gtmr_msgs_py.message_error import MessageError
from gtmr_msgs_py.topics import BASE_LINK, MAP


def encode(stamp_ns: int, x: ArrayLike) -> Odometry:
    """Make the odometry of a state.

    Parameters
    ----------
    stamp_ns : int
        When the state was measured [ns].
    x : array_like, shape (12,) or longer
        State [p, eta, v, omega, ...]: m, rad, m/s, rad/s; p and v in world ENU, omega in body FLU.

    Returns
    -------
    nav_msgs.msg.Odometry
        Covariances are zero, that is, not known.
    """
    state = np.asarray(x, dtype=float)
    msg = Odometry()
    msg.header.stamp = stamps.encode(stamp_ns)
    msg.header.frame_id = MAP
    msg.child_frame_id = BASE_LINK
    msg.pose.pose.position = _xyz(Point, state[POSITION])
    msg.pose.pose.orientation = orientation = attitude.encode(state[ATTITUDE])
    msg.twist.twist.linear = _xyz(Vector3, attitude.rotation(orientation).T @ state[VELOCITY])
    msg.twist.twist.angular = _xyz(Vector3, state[RATE])
    return msg


def decode(msg: Odometry) -> tuple[int, NDArray[np.float64]]:
    """Read the state out of an odometry message.

    Parameters
    ----------
    msg : nav_msgs.msg.Odometry
        Twist in the child frame, as the message's definition says.

    Returns
    -------
    stamp_ns : int
        When the state was measured [ns].
    x : NDArray, shape (12,)
        State [p, eta, v, omega]; yaw is within -pi to pi.

    Raises
    ------
    MessageError
        If a number is not finite or the orientation is no unit quaternion.
    """
    pose, twist = msg.pose.pose, msg.twist.twist
    body_to_world = attitude.rotation(pose.orientation)
    x = np.empty(12)
    x[POSITION] = pose.position.x, pose.position.y, pose.position.z
    x[ATTITUDE] = attitude.roll_pitch_yaw(body_to_world)
    x[VELOCITY] = body_to_world @ (twist.linear.x, twist.linear.y, twist.linear.z)
    x[RATE] = twist.angular.x, twist.angular.y, twist.angular.z
    if not np.isfinite(x).all():
        raise MessageError(f"odometry is not finite: {x}")
    return stamps.decode(msg.header.stamp), x


def _xyz(message: type, values: NDArray[np.float64]) -> Point | Vector3:
    x, y, z = (float(value) for value in values)
    return message(x=x, y=y, z=z)
