# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The topics and services of the suite as ROS objects: classes, quality of service, endpoints.

Their names, types and contents are those of `contract`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import SetBool, Trigger

from gtmr_msgs_py import contract
from gtmr_msgs_py.contract import TopicName

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.subscription import Subscription

OFFERED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=2000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""What every publisher offers: nothing is lost to a stall of 10 s at 200 Hz."""
NEWEST = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""What the control loop asks for: only the newest counts, from any estimator or controller."""


def message_class(type_name: str) -> type:
    """Import a message class by its interface name, for example ``nav_msgs/msg/Odometry``.

    Raises ImportError if it is not installed.
    """
    package, kind, name = type_name.split("/")
    try:
        message: type = getattr(import_module(f"{package}.{kind}"), name)
    except AttributeError:
        raise ImportError(f"there is no {type_name}") from None
    return message


@dataclass(frozen=True)
class Topic(TopicName):
    """A topic of the suite, ready to publish and to listen to."""

    message: type
    """The message class."""
    qos: QoSProfile
    """Quality of service that publishers offer."""

    @classmethod
    def of(cls, topic: TopicName, qos: QoSProfile = OFFERED) -> Topic:
        """Make a topic of what the contract says of it."""
        return cls(**vars(topic), message=message_class(topic.type_name), qos=qos)

    def publisher(self, node: Node) -> Publisher:
        """Create a publisher of this topic."""
        return node.create_publisher(self.message, self.name, self.qos)

    def subscription(
        self,
        node: Node,
        callback: Callable[[Any], None],
        qos: QoSProfile | None = None,
        raw: bool = False,
    ) -> Subscription:
        """Create a subscription to this topic.

        Quality of service is as offered if left out, as a recorder wants it; control loops ask for
        ``NEWEST``. A raw callback gets CDR bytes rather than a message.
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
        package, kind, *_ = self.service.__module__.split(".")
        return f"{package}/{kind}/{self.service.__name__}"


def _if_installed(topic: TopicName) -> Topic | None:
    try:
        return Topic.of(topic)
    except ModuleNotFoundError:
        return None


ODOM = Topic.of(contract.ODOM)
GROUND_TRUTH = Topic.of(contract.GROUND_TRUTH)
ROTOR_STATES = Topic.of(contract.ROTOR_STATES)
ROTOR_COMMAND = Topic.of(contract.ROTOR_COMMAND)
GUARD = Topic.of(contract.GUARD)
REFERENCE = Topic.of(contract.REFERENCE)
PREDICTED_PATH = Topic.of(contract.PREDICTED_PATH)
TIGHTENING = Topic.of(contract.TIGHTENING)
SOLVE_TIME = Topic.of(contract.SOLVE_TIME)
CLEARANCE = Topic.of(contract.CLEARANCE)
CLEARANCE_RESIDUAL = Topic.of(contract.CLEARANCE_RESIDUAL)
DIAGNOSTICS = Topic.of(contract.DIAGNOSTICS)
MARKERS = Topic.of(contract.MARKERS)
TF = _if_installed(contract.TF)
"""The transform of the vehicle; None where there is no ``tf2_msgs``, which is not on PyPI."""
CLOCK = Topic.of(contract.CLOCK)

TOPICS = (
    ODOM,
    GROUND_TRUTH,
    ROTOR_STATES,
    ROTOR_COMMAND,
    GUARD,
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
