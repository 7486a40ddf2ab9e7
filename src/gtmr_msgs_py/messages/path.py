# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Paths through space as nav_msgs/Path."""

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from numpy.typing import ArrayLike, NDArray

from gtmr_msgs_py.contract import MAP
from gtmr_msgs_py.wire import attitude, stamps


def encode(
    stamp_ns: int, step_ns: int, positions: ArrayLike, rpy: ArrayLike, world_frame: str = MAP
) -> Path:
    """Make a path of poses that follow each other at an even pace.

    The first is due at the stamp [ns], the next one step [ns] later; positions are in the world
    frame [m] and rpy are roll, pitch, yaw [rad], both of shape (n, 3).
    """
    msg = Path()
    msg.header.frame_id = world_frame
    msg.header.stamp = stamps.encode(stamp_ns)
    poses = []
    rows = zip(np.asarray(positions).tolist(), np.asarray(rpy).tolist(), strict=True)
    for i, ((x, y, z), angles) in enumerate(rows):
        pose = PoseStamped()
        pose.header.frame_id = world_frame
        pose.header.stamp = stamps.encode(stamp_ns + i * step_ns)
        point = pose.pose.position
        point.x, point.y, point.z = float(x), float(y), float(z)
        pose.pose.orientation = attitude.encode(angles)
        poses.append(pose)
    msg.poses = poses
    return msg


def decode(msg: Path) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Read when a path is where: stamps [ns], shape (n,), and positions [m], shape (n, 3)."""
    points = [pose.pose.position for pose in msg.poses]
    times = np.array([stamps.decode(pose.header.stamp) for pose in msg.poses], dtype=np.int64)
    return times, np.array([(p.x, p.y, p.z) for p in points]).reshape(-1, 3)
