# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Attitude as messages have it, a quaternion, and as the state has it: roll, pitch, yaw.

All three forms turn vectors from the body frame (FLU) into the world frame (ENU), with
R = Rz(yaw) Ry(pitch) Rx(roll).
"""

import math

import numpy as np
from geometry_msgs.msg import Quaternion
from numpy.typing import ArrayLike, NDArray

from gtmr_msgs_py.wire.message_error import MessageError

UNIT_TOLERANCE = 1e-3
"""How far the norm of a quaternion may be from one; estimators round."""


def encode(rpy: ArrayLike) -> Quaternion:
    """Turn roll, pitch and yaw [rad], of any size, into a unit quaternion."""
    roll, pitch, yaw = (0.5 * float(angle) for angle in np.asarray(rpy))
    c_r, s_r = math.cos(roll), math.sin(roll)
    c_p, s_p = math.cos(pitch), math.sin(pitch)
    c_y, s_y = math.cos(yaw), math.sin(yaw)
    return Quaternion(
        x=s_r * c_p * c_y - c_r * s_p * s_y,
        y=c_r * s_p * c_y + s_r * c_p * s_y,
        z=c_r * c_p * s_y - s_r * s_p * c_y,
        w=c_r * c_p * c_y + s_r * s_p * s_y,
    )


def quaternions(rpy: ArrayLike) -> NDArray[np.float64]:
    """Turn angles as of `encode`, shape (n, 3), into unit quaternions x, y, z, w, shape (n, 4)."""
    halves = 0.5 * np.asarray(rpy, dtype=float).T
    (c_r, c_p, c_y), (s_r, s_p, s_y) = np.cos(halves), np.sin(halves)
    return np.stack(
        [
            s_r * c_p * c_y - c_r * s_p * s_y,
            c_r * s_p * c_y + s_r * c_p * s_y,
            c_r * c_p * s_y - s_r * s_p * c_y,
            c_r * c_p * c_y + s_r * s_p * s_y,
        ],
        axis=1,
    )


def rotation(quaternion: Quaternion) -> NDArray[np.float64]:
    """Turn a quaternion into a rotation matrix from body to world, shape (3, 3).

    Raises MessageError if its norm is not one but for rounding, or not a number.
    """
    x, y, z, w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(norm - 1.0) <= UNIT_TOLERANCE:
        raise MessageError(f"orientation ({x:g}, {y:g}, {z:g}, {w:g}) is no unit quaternion")
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def roll_pitch_yaw(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn a rotation matrix from body to world, Rz(yaw) Ry(pitch) Rx(roll), into three angles.

    Roll and yaw are within -pi to pi, pitch within -pi/2 to pi/2 [rad].
    """
    r = rotation
    return np.array(
        [
            math.atan2(r[2, 1], r[2, 2]),
            math.atan2(-r[2, 0], math.hypot(r[2, 1], r[2, 2])),
            math.atan2(r[1, 0], r[0, 0]),
        ]
    )
