# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Position, attitude, velocity and body rates as nav_msgs/Odometry.

The state has its velocity in the world frame, the message in the child frame: it is rotated only
here.
"""

from functools import lru_cache

import numpy as np
from geometry_msgs.msg import Quaternion
from nav_msgs.msg import Odometry
from numpy.typing import ArrayLike, NDArray

from gtmr_model.dynamics import ATTITUDE, POSITION, RATE, VELOCITY
from gtmr_msgs_py.contract import Frames
from gtmr_msgs_py.wire import attitude, stamps
from gtmr_msgs_py.wire.fixed_cdr import FixedCdr
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_msgs_py.wire.reading import read

POSE = slice(0, 7)
"""Position and quaternion among the numbers of the message."""
TWIST = slice(43, 49)
"""Linear and angular velocity among them."""
NUMBERS = 85
"""How many there are, with two covariances of 36."""
OURS = Frames()
"""`map` and `base_link`."""


def decode(msg: Odometry) -> tuple[int, NDArray[np.float64]]:
    """Read when a state was measured [ns], and the state [p, eta, v, omega], shape (12,).

    Units and frames are those of `pack`, whatever their names; yaw is within -pi to pi. Raises
    MessageError if a number is not finite or the orientation is no unit quaternion.
    """
    pose, twist = msg.pose.pose, msg.twist.twist
    x = _state(
        (pose.position.x, pose.position.y, pose.position.z),
        pose.orientation,
        (twist.linear.x, twist.linear.y, twist.linear.z),
        (twist.angular.x, twist.angular.y, twist.angular.z),
    )
    return stamps.decode(msg.header.stamp), x


def pack(stamp_ns: int, x: ArrayLike, frames: Frames = OURS) -> bytes:
    """Make CDR bytes of a nav_msgs/Odometry, of a state that was measured at a stamp [ns].

    State [p, eta, v, omega, ...]: m, rad, m/s, rad/s; p and v in world ENU, omega in body FLU.
    Covariances are zero, that is, not known.
    """
    state = np.asarray(x, dtype=float)
    q = attitude.encode(state[ATTITUDE])
    numbers = np.zeros(NUMBERS)
    numbers[POSE] = *state[POSITION], q.x, q.y, q.z, q.w
    numbers[TWIST] = *(attitude.rotation(q).T @ state[VELOCITY]), *state[RATE]
    return _layout(frames).pack(stamp_ns, numbers)


def unpack(data: bytes, frames: Frames = OURS) -> tuple[int, NDArray[np.float64]]:
    """Read the state as `decode` does, out of CDR bytes from anywhere.

    Those of `pack` take half the time. Raises MessageError for what `decode` refuses, for what is
    no odometry, and for one of other frames.
    """
    unpacked = _layout(frames).unpack(data)
    if unpacked is None:
        msg = read(data, Odometry)
        theirs = Frames(msg.header.frame_id, msg.child_frame_id)
        if theirs != frames:
            raise MessageError(
                f"odometry of {theirs.body!r} in {theirs.world!r}: expected {frames.body!r} in "
                f"{frames.world!r}",
                "frame",
            )
        return decode(msg)
    stamp_ns, numbers = unpacked
    p_x, p_y, p_z, q_x, q_y, q_z, q_w = numbers[POSE].tolist()
    twist = numbers[TWIST]
    orientation = Quaternion(x=q_x, y=q_y, z=q_z, w=q_w)
    return stamp_ns, _state((p_x, p_y, p_z), orientation, twist[:3], twist[3:])


def _state(
    position: ArrayLike, orientation: Quaternion, linear: ArrayLike, angular: ArrayLike
) -> NDArray[np.float64]:
    """Turn the twist, which a message has in the child frame, and the attitude."""
    body_to_world = attitude.rotation(orientation)
    x = np.empty(12)
    x[POSITION] = position
    x[ATTITUDE] = attitude.roll_pitch_yaw(body_to_world)
    x[VELOCITY] = body_to_world @ np.asarray(linear)
    x[RATE] = angular
    if not np.isfinite(x).all():
        raise MessageError(f"odometry is not finite: {x}")
    return x


@lru_cache(maxsize=8)
def _layout(frames: Frames) -> FixedCdr:
    layout = FixedCdr()
    layout.header(frames.world)
    layout.string(frames.body)
    layout.float64(NUMBERS)
    return layout
