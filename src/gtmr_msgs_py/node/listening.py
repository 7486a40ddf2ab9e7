# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Subscriptions of a recorder: every message, as bytes, with the time when it came."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from inspect import signature
from typing import TYPE_CHECKING

from nav_msgs.msg import Odometry
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from gtmr_msgs_py.topics import Topic

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.subscription import Subscription

FROM_ANY_ESTIMATOR = (Odometry, JointState)
"""Messages that on a real vehicle come from elsewhere, often best effort."""
PATIENT = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)
"""QoS of a recorder: in lockstep a simulator may be faster than a recorder, and 2000 messages of
the control loop are a flight of 50 s."""
BEST_EFFORT = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""QoS of a recorder if a publisher offers no more."""
NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""Every event handler is one more thing to wait for, at every message of any topic."""

Info = Mapping[str, int]
"""What the middleware tells about a message."""
OnMessage = Callable[..., None]
"""Gets a message as CDR bytes, and what the middleware tells of it as a second argument."""


def listen(node: Node, topic: Topic, on_message: OnMessage) -> None:
    """Subscribe so that nothing is lost, or as reliably as another publisher allows."""

    def ask_for_less() -> None:
        # A best-effort subscription gets what either kind of publisher sends.
        node.get_logger().warning(f"{topic.name} is published best effort: messages may be lost")
        node.destroy_subscription(reliable)
        _subscribe(node, topic, on_message, BEST_EFFORT, NO_EVENTS)

    events = NO_EVENTS
    if topic.message in FROM_ANY_ESTIMATOR:
        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda _: ask_for_less(), use_default_callbacks=False
        )
    reliable = _subscribe(node, topic, on_message, PATIENT, events)


def take_what_arrived(node: Node) -> None:
    """Deliver, at the end, the messages that came but were not delivered yet."""
    for subscription in node.subscriptions:
        # That to the simulated time, which rclpy makes, is not told of anything else.
        told = len(signature(subscription.callback).parameters)
        with subscription.handle:
            while taken := subscription.handle.take_message(
                subscription.msg_type, subscription.raw
            ):
                subscription.callback(*taken[:told])


def received_ns(info: Info) -> int:
    """Time at which the middleware got a message [ns]; the present if it does not say."""
    return info["received_timestamp"] or time.time_ns()


def _subscribe(
    node: Node,
    topic: Topic,
    on_message: OnMessage,
    qos: QoSProfile,
    events: SubscriptionEventCallbacks,
) -> Subscription:
    return node.create_subscription(
        topic.message, topic.name, on_message, qos, raw=True, event_callbacks=events
    )
