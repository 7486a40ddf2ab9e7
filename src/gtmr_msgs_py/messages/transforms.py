# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The vehicle's pose as the transform from `map` to `base_link`, for tf2.

``tf2_msgs`` comes with an installed ROS 2 and not with the wheels on PyPI. Without it nobody can
publish a transform, but a bag can hold it all the same: here are its bytes.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from gtmr_model.dynamics import ATTITUDE, POSITION
from gtmr_msgs_py.contract import TOWER_FRAME, Frames
from gtmr_msgs_py.wire import attitude
from gtmr_msgs_py.wire.fixed_cdr import FixedCdr

OURS = Frames()
"""`map` and `base_link`."""


def pack(stamp_ns: int, x: ArrayLike, frames: Frames = OURS) -> bytes:
    """Make CDR bytes of a tf2_msgs/TFMessage: the pose of the body (FLU) in the world (ENU).

    The state [p, eta, ...] was measured at the stamp [ns]: world ENU [m], [rad].
    """
    state = np.asarray(x, dtype=float)
    q = attitude.encode(state[ATTITUDE])
    return _layout(frames.world, frames.body).pack(
        stamp_ns, [*state[POSITION], q.x, q.y, q.z, q.w]
    )


def pack_tower(frames: Frames = OURS) -> bytes:
    """Make CDR bytes of a tf2_msgs/TFMessage that never changes: the tower's foot."""
    return _layout(frames.world, TOWER_FRAME).pack(0, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@lru_cache(maxsize=8)
def _layout(world: str, child: str) -> FixedCdr:
    """One geometry_msgs/TransformStamped: translation, and rotation as a quaternion."""
    layout = FixedCdr()
    layout.uint32(1)
    layout.header(world)
    layout.string(child)
    layout.float64(7)
    return layout
