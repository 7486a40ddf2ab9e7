# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The topics and services of the suite: names, types, quality of service, who talks to whom.

Names are relative, so that namespaces and remaps work; only what ROS itself fixes is absolute.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry, Path
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

try:
    from tf2_msgs.msg import TFMessage
except ModuleNotFoundError:
    # Not on PyPI: it comes with an installed ROS 2 only.
    TFMessage = None

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.subscription import Subscription

MAP = "map"
"""World frame, ENU (REP-105)."""
BASE_LINK = "base_link"
"""Body frame, FLU (REP-103)."""

OFFERED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""What every publisher offers: nothing is lost to a short stall."""
NEWEST = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""What the control loop asks for: only the newest counts, from any estimator or controller."""


@dataclass(frozen=True)
class Topic:
    """A topic of the suite."""

    name: str
    """Relative unless it starts with a slash."""
    message: type
    """The message class."""
    publishers: tuple[str, ...]
    """Names of the nodes that publish it."""
    subscribers: tuple[str, ...]
    """Names of the nodes that need it; the monitor records every topic anyway."""
    content: str
    """What it carries, with units and frames."""
    qos: QoSProfile = field(default_factory=lambda: OFFERED)
    """Quality of service that publishers offer."""

    @property
    def type_name(self) -> str:
        """Interface name, for example ``nav_msgs/msg/Odometry``."""
        return _interface_name(self.message)

    def publisher(self, node: Node) -> Publisher:
        """Create a publisher of this topic.

        Parameters
        ----------
        node : rclpy.node.Node
            Who publishes.

        Returns
        -------
        rclpy.publisher.Publisher
        """
        return node.create_publisher(self.message, self.name, self.qos)

    def subscription(
        self,
        node: Node,
        callback: Callable[[Any], None],
        qos: QoSProfile | None = None,
        raw: bool = False,
    ) -> Subscription:
        """Create a subscription to this topic.

        Parameters
        ----------
        node : rclpy.node.Node
            Who subscribes.
        callback : callable
            Gets every message.
        qos : rclpy.qos.QoSProfile, optional
            What is offered if left out, as a recorder wants it; control loops ask for ``NEWEST``.
        raw : bool
            Whether the callback gets CDR bytes rather than a message.

        Returns
        -------
        rclpy.subscription.Subscription
        """
        qos = self.qos if qos is None else qos
        return node.create_subscription(self.message, self.name, callback, qos, raw=raw)


@dataclass(frozen=True)
class ServiceName:
    """A service of the suite, beside the parameter services that every node has."""

    name: str
    """Private to its node."""
    service: type
    """The service class."""
    server: str
    """Name of the node that serves it."""
    content: str
    """What it does."""

    @property
    def type_name(self) -> str:
        """Interface name, for example ``std_srvs/srv/Trigger``."""
        return _interface_name(self.service)


def _interface_name(interface: type) -> str:
    package, kind, *_ = interface.__module__.split(".")
    return f"{package}/{kind}/{interface.__name__}"


ODOM = Topic(
    "odom",
    Odometry,
    ("sim",),
    ("nmpc", "monitor"),
    "Pose of `base_link` (FLU) in `map` (ENU) [m]; twist in `base_link` [m/s, rad/s]",
)
ROTOR_STATES = Topic(
    "rotor_states",
    JointState,
    ("sim",),
    ("nmpc", "monitor"),
    "`velocity` of every rotor [rad/s], named `rotor_0` on; stamped as the odometry it belongs to",
)
ROTOR_COMMAND = Topic(
    "rotor_command",
    JointTrajectory,
    ("nmpc",),
    ("sim", "monitor"),
    "The whole plan: point i, at i T_s after the stamp of its odometry, has `velocities` [rad/s] "
    "and `accelerations` [rad/s^2]; point N holds the speed",
)
REFERENCE = Topic("reference", Path, ("nmpc",), ("monitor",), "The helix ahead, in `map` [m]")
PREDICTED_PATH = Topic(
    "predicted_path", Path, ("nmpc",), ("monitor",), "The plan's N + 1 poses, in `map` [m]"
)
TIGHTENING = Topic(
    "tightening",
    Float64MultiArray,
    ("nmpc",),
    ("monitor",),
    "Row i is stage i: the terms of alpha_p by channel, eps_s, alpha_g and the slack [m]",
)
SOLVE_TIME = Topic(
    "solve_time",
    Float64,
    ("nmpc",),
    ("monitor",),
    "Preparation and feedback of one controller step, wall time [s]",
)
CLEARANCE = Topic(
    "clearance",
    Range,
    ("monitor",),
    (),
    "`range` is the clearance d_T, `min_range` is d_min [m]",
)
CLEARANCE_RESIDUAL = Topic(
    "clearance_residual",
    Float64,
    ("monitor",),
    (),
    "s = d_min - d_T [m]; above zero the constraint is violated",
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    DiagnosticArray,
    ("sim", "nmpc", "monitor"),
    ("monitor",),
    "Once a second: solve times, deadline misses, QP status, mode, command age, violations",
)
MARKERS = Topic(
    "markers",
    MarkerArray,
    ("sim", "nmpc"),
    ("monitor",),
    "Tower, d_min shell and vehicle (sim); tightened shell and plan (nmpc)",
)
# Relative, where tf2 has it absolute: without a namespace it is /tf all the same, and of two
# vehicles in two namespaces neither moves the other's base_link.
TF = (
    Topic("tf", TFMessage, ("sim",), (), "Pose of `base_link` in `map`, where tf2_msgs is there")
    if TFMessage is not None
    else None
)
"""The transform of the vehicle, or None where ``tf2_msgs`` is not installed."""
CLOCK = Topic("/clock", Clock, ("sim",), ("monitor",), "Simulated time, zero at the start")

TOPICS = (
    ODOM,
    ROTOR_STATES,
    ROTOR_COMMAND,
    REFERENCE,
    PREDICTED_PATH,
    TIGHTENING,
    SOLVE_TIME,
    CLEARANCE,
    CLEARANCE_RESIDUAL,
    DIAGNOSTICS,
    MARKERS,
    *([] if TF is None else [TF]),
    CLOCK,
)
"""Every topic of the suite, in the order of the documentation."""

RESET = ServiceName("~/reset", Trigger, "sim", "Go back to the start of the same flight")
PAUSE = ServiceName("~/pause", SetBool, "sim", "Stop simulated time, or let it go on")

SERVICES = (RESET, PAUSE)
"""Every service of the suite."""
