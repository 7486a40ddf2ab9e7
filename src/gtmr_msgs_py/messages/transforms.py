# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The vehicle's pose as the transform from `map` to `base_link`, for tf2.

``tf2_msgs`` comes with an installed ROS 2 and not with the wheels on PyPI: without it there is no
transform, and every view of the suite still works, since all else is published in `map`.
"""

from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped, Vector3
from numpy.typing import ArrayLike

from gtmr_model.dynamics import ATTITUDE, POSITION
from gtmr_msgs_py.contract import TF, Frames
from gtmr_msgs_py.topics import message_class
from gtmr_msgs_py.wire import attitude, stamps

OURS = Frames()
"""`map` and `base_link`."""


def encode(stamp_ns: int, x: ArrayLike, frames: Frames = OURS) -> Any:
    """Make the tf2_msgs/TFMessage of a state as `transform` does; this needs ``tf2_msgs``."""
    return message_class(TF.type_name)(transforms=[transform(stamp_ns, x, frames)])


def transform(stamp_ns: int, x: ArrayLike, frames: Frames = OURS) -> TransformStamped:
    """Make the transform of a state: the pose of the body frame (FLU) in the world frame (ENU).

    The state [p, eta, ...] was measured at the stamp [ns]: world ENU [m], [rad].
    """
    state = np.asarray(x, dtype=float)
    px, py, pz = (float(value) for value in state[POSITION])
    msg = TransformStamped(child_frame_id=frames.body)
    msg.header.stamp = stamps.encode(stamp_ns)
    msg.header.frame_id = frames.world
    msg.transform.translation = Vector3(x=px, y=py, z=pz)
    msg.transform.rotation = attitude.encode(state[ATTITUDE])
    return msg
