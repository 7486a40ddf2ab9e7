# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The ROS contract without ROS: names, types as text, columns, units and frames, stated once.

Readers of bags use it where there is no ROS; `topics` makes publishers and subscriptions of it.
Names are relative, so that namespaces and remaps work; only what ROS itself fixes is absolute.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from gtmr_model.uncertainty import CHANNELS

MAP = "map"
"""World frame, ENU (REP-105)."""
BASE_LINK = "base_link"
"""Body frame, FLU (REP-103)."""
TOWER_FRAME = "tower"
"""The tower's axis at the ground; it has the world's axes."""
RAD_PER_TURN = 2.0 * math.pi
"""From Hz of the state to rad/s of messages, and from Hz/s to rad/s^2."""
TIGHTENING_COLUMNS = (*CHANNELS, "eps_s", "alpha_g", "slack")
"""What a row of `tightening` holds: terms of alpha_p, eq. (12), alpha_g, eq. (13), slack [m];
further margins may follow, each with a label of its own."""
TIGHTENING_STAGE = "stage"
"""Label of the first dimension of `tightening`; that of the second is the columns."""


class Frames(NamedTuple):
    """The two frames of a vehicle by name; those of several vehicles may differ."""

    world: str = MAP
    """World frame, ENU (REP-105)."""
    body: str = BASE_LINK
    """Body frame, FLU (REP-103)."""


def rotor_names(n_rotors: int) -> list[str]:
    """Name the rotors as joints, ``rotor_0`` on, in the order of the state."""
    return [f"rotor_{i}" for i in range(n_rotors)]


@dataclass(frozen=True)
class TopicName:
    """A topic of the suite, as its documentation and a bag know it."""

    name: str
    """Relative unless it starts with a slash."""
    type_name: str
    """Interface name, for example ``nav_msgs/msg/Odometry``."""
    publishers: tuple[str, ...]
    """Names of the nodes that publish it."""
    subscribers: tuple[str, ...]
    """Names of the nodes that need it; the monitor records every topic anyway."""
    content: str
    """What it carries, with units and frames."""


ODOM = TopicName(
    "odom",
    "nav_msgs/msg/Odometry",
    ("sim",),
    ("nmpc", "monitor"),
    "Pose of `base_link` (FLU) in `map` (ENU) [m]; twist in `base_link` [m/s, rad/s]: as it is "
    "measured, stamped with when that was",
)
GROUND_TRUTH = TopicName(
    "ground_truth",
    "nav_msgs/msg/Odometry",
    ("sim",),
    ("monitor",),
    "The true state in the same frames and units; the clearance is taken from it",
)
ROTOR_STATES = TopicName(
    "rotor_states",
    "sensor_msgs/msg/JointState",
    ("sim",),
    ("nmpc", "monitor"),
    "`velocity` of every rotor [rad/s], named `rotor_0` on; stamped as the odometry it belongs to",
)
ROTOR_COMMAND = TopicName(
    "rotor_command",
    "trajectory_msgs/msg/JointTrajectory",
    ("nmpc",),
    ("sim", "monitor"),
    "The whole plan: point i, at i T_s after its stamp, has `velocities` [rad/s], the setpoints "
    "of motors, and `accelerations` [rad/s^2]; point N holds the speed. Its stamp is that of its "
    "odometry, later by `delay_s`",
)
GUARD = TopicName(
    "guard",
    "std_msgs/msg/Bool",
    ("sim",),
    ("monitor",),
    "Whether the guard is in charge rather than the controller; with every odometry",
)
REFERENCE = TopicName(
    "reference", "nav_msgs/msg/Path", ("nmpc",), ("monitor",), "The helix ahead, in `map` [m]"
)
PREDICTED_PATH = TopicName(
    "predicted_path",
    "nav_msgs/msg/Path",
    ("nmpc",),
    ("monitor",),
    "The plan's N + 1 poses, in `map` [m]",
)
TIGHTENING = TopicName(
    "tightening",
    "std_msgs/msg/Float64MultiArray",
    ("nmpc",),
    ("monitor",),
    "Row i is stage i: the terms of alpha_p by channel, eps_s, alpha_g, the slack, and "
    "further margins, such as `noise`, by label [m]",
)
SOLVE_TIME = TopicName(
    "solve_time",
    "std_msgs/msg/Float64",
    ("nmpc",),
    ("monitor",),
    "Preparation and feedback of one controller step, wall time [s]",
)
CLEARANCE = TopicName(
    "clearance",
    "sensor_msgs/msg/Range",
    ("monitor",),
    (),
    "`range` is the clearance d_T [m], negative inside the tower; never out of range",
)
CLEARANCE_RESIDUAL = TopicName(
    "clearance_residual",
    "std_msgs/msg/Float64",
    ("monitor",),
    (),
    "s = d_min - d_T [m]; above zero the constraint is violated",
)
DIAGNOSTICS = TopicName(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    ("sim", "nmpc", "monitor"),
    ("monitor",),
    "Once a second: solve times, deadline misses, QP status, mode, command age, violations",
)
MARKERS = TopicName(
    "markers",
    "visualization_msgs/msg/MarkerArray",
    ("sim", "nmpc"),
    ("monitor",),
    "Tower, d_min shell and vehicle (sim); tightened shell and plan (nmpc)",
)
# Relative, where tf2 has it absolute: without a namespace it is /tf all the same, and of two
# vehicles in two namespaces neither moves the other's base_link.
TF = TopicName(
    "tf",
    "tf2_msgs/msg/TFMessage",
    ("sim",),
    (),
    "Pose of `base_link` in `map`, where tf2_msgs is there; in a bag always",
)
TF_STATIC = TopicName(
    "/tf_static",
    "tf2_msgs/msg/TFMessage",
    (),
    (),
    "`tower` in `map`, at the start of every bag: viewers have a frame before the flight begins",
)
CLOCK = TopicName(
    "/clock",
    "rosgraph_msgs/msg/Clock",
    ("sim",),
    ("nmpc", "monitor"),
    "Simulated time, zero at the start",
)
PARAMETER_EVENTS = TopicName(
    "/parameter_events",
    "rcl_interfaces/msg/ParameterEvent",
    (),
    (),
    "Parameters of every node that were declared or changed",
)
