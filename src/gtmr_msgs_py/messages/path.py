# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Paths through space as nav_msgs/Path."""

from functools import lru_cache

import numpy as np
from nav_msgs.msg import Path
from numpy.typing import ArrayLike, NDArray

from gtmr_msgs_py.contract import MAP
from gtmr_msgs_py.wire import attitude, stamps
from gtmr_msgs_py.wire.fixed_cdr import FixedCdr


def pack(
    stamp_ns: int, step_ns: int, positions: ArrayLike, rpy: ArrayLike, world_frame: str = MAP
) -> bytes:
    """Make CDR bytes of a nav_msgs/Path of poses that follow each other at an even pace.

    The first is due at the stamp [ns], the next one step [ns] later; positions are in the world
    frame [m] and rpy are roll, pitch, yaw [rad], both of shape (n, 3).
    """
    poses = np.hstack([np.asarray(positions, dtype=float), attitude.quaternions(rpy)])
    return _layout(step_ns, len(poses), world_frame).pack(stamp_ns, poses.ravel())


def decode(msg: Path) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Read when a path is where: stamps [ns], shape (n,), and positions [m], shape (n, 3)."""
    points = [pose.pose.position for pose in msg.poses]
    times = np.array([stamps.decode(pose.header.stamp) for pose in msg.poses], dtype=np.int64)
    return times, np.array([(p.x, p.y, p.z) for p in points]).reshape(-1, 3)


@lru_cache(maxsize=8)
def _layout(step_ns: int, n_poses: int, world_frame: str) -> FixedCdr:
    layout = FixedCdr()
    layout.header(world_frame)
    layout.uint32(n_poses)
    for i in range(n_poses):
        layout.header(world_frame, after_ns=i * step_ns)
        # Position and quaternion.
        layout.float64(7)
    return layout
