# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The distance to the tower as sensor_msgs/Range, and its residual as std_msgs/Float64."""

import math

from sensor_msgs.msg import Range
from std_msgs.msg import Float64

from gtmr_msgs_py.contract import BASE_LINK
from gtmr_msgs_py.wire import stamps

DRAWN_CONE_RAD = 0.1
"""Angle of the cone by which viewers show the distance, ahead of the vehicle, which faces the
tower [rad]."""


def encode(stamp_ns: int, clearance_m: float, body_frame: str = BASE_LINK) -> Range:
    """Make the range message of a clearance d_T [m], negative inside the tower.

    The stamp [ns] is that of the odometry it was computed from. The range has single precision,
    and no value is out of it, as viewers hide those.
    """
    msg = Range(
        radiation_type=Range.INFRARED,
        field_of_view=DRAWN_CONE_RAD,
        min_range=-math.inf,
        max_range=math.inf,
        range=float(clearance_m),
    )
    msg.header.stamp = stamps.encode(stamp_ns)
    msg.header.frame_id = body_frame
    return msg


def encode_residual(residual_m: float) -> Float64:
    """Make the message of a residual s = d_min - d_T [m]."""
    return Float64(data=float(residual_m))
