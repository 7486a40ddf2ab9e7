# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A node that is plain, or managed by lifecycle services."""

import time
import traceback
from collections.abc import Callable, Iterable
from functools import wraps
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node

from gtmr_model import ConfigError
from gtmr_msgs_py.node.parameter_events import PARAMETER_EVENTS, own_parameters
from gtmr_msgs_py.wire.drops import WARNING_PERIOD_S, Drops
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_msgs_py.wire.reading import read


class Chores:
    """What a node does now and then: one thing at a time, and after what the loop waits for.

    Each is due once a period, wall time [s], and is then done when the node next has served the
    loop; while there is nothing to serve, at the end of the period.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._due: list[Callable[[], object]] = []

    def add(self, period_s: float, work: Callable[[], object]) -> None:
        """Do some work once a period [s], the first time as soon as there is time."""

        def fall_due() -> None:
            if work in self._due:
                work()
            else:
                self._due.append(work)

        self._due.append(work)
        self._node.create_timer(period_s, fall_due, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def do_one(self) -> None:
        """Do what has been due for longest, if anything is."""
        if self._due:
            self._due.pop(0)()


class SuiteNode(LifecycleNode):
    """The base of the suite's nodes: declares in the constructor, allocates, then connects.

    A plain node does all three at once. A managed one allocates when lifecycle services configure
    it and connects when they activate it; while it is not active it hears nothing, and so
    publishes nothing. No message ends it: what cannot be used is counted in ``drops``.
    """

    def __init__(self, name: str, managed: bool) -> None:
        self.drops = Drops(self.warn)
        """The messages that were not used, except those that are counted elsewhere."""
        self.callback_errors = 0
        """How many messages made a callback fail unexpectedly."""
        self._told_error_s = -WARNING_PERIOD_S
        super().__init__(name, enable_communication_interface=managed)
        self.connected = False
        """Whether it takes part in the graph; only then need parameters be applied at once, as
        connecting applies them too."""
        self.over = False
        """Whether it has done what it was started for, so that its process may end."""
        self._kept: list[list[Any]] = []
        self._parameters_again = PARAMETER_EVENTS.publisher(self)

    def warn(self, reason: str) -> None:
        """Say in the log what is wrong."""
        self.get_logger().warning(reason)

    def create_subscription(
        self,
        msg_type: type,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: Any,
        *,
        raw: bool = False,
        **options: Any,
    ) -> Any:
        """Subscribe, as any node does, so that no message leaves the callback as an exception.

        rclpy's own subscriptions, such as that to the simulated time, come through here too. All
        are raw: a message that cannot be decoded must fail in here, not in the executor.
        """

        @wraps(callback)
        def take(data: bytes, *info: Any) -> None:
            try:
                callback(data if raw else read(data, msg_type), *info)
            except MessageError as error:
                self.drops.add(error)
            except Exception:
                self._tell_callback_error(topic)

        return super().create_subscription(msg_type, topic, take, qos_profile, raw=True, **options)

    def _tell_callback_error(self, topic: str) -> None:
        self.callback_errors += 1
        now_s = time.monotonic()
        if now_s - self._told_error_s >= WARNING_PERIOD_S:
            self._told_error_s = now_s
            self.get_logger().error(
                f"failed at a message on {topic}, going on:\n{traceback.format_exc()}"
            )

    def tell_parameters(self) -> None:
        """Publish all parameters again as a flight begins, for a recorder that came since.

        What rclpy publishes when they are declared is long gone by then.
        """
        event = own_parameters(self)
        event.stamp = self.get_clock().now().to_msg()
        self._parameters_again.publish(event)

    def start(self) -> None:
        """Do at once what lifecycle services would otherwise ask for.

        Raises ConfigError if a parameter cannot be used.
        """
        self.allocate()
        self.connect()
        self.connected = True

    def allocate(self) -> None:
        """Make what takes time or memory, and the publishers.

        Raises ConfigError if a parameter cannot be used.
        """
        raise NotImplementedError

    def connect(self) -> None:
        """Make the subscriptions, services, clients and timers."""
        raise NotImplementedError

    def release(self) -> None:
        """Give back what was allocated; publishers go by themselves."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Allocate; a parameter that cannot be used leaves the node unconfigured."""
        before = self._made()
        try:
            self.allocate()
        except ConfigError as error:
            self.get_logger().error(str(error))
            self._destroy_all_but(before)
            return TransitionCallbackReturn.FAILURE
        self._kept.append(before)
        self.get_logger().info("configured")
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Connect."""
        self._kept.append(self._made())
        self.connect()
        self.connected = True
        self.get_logger().info("active")
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Disconnect."""
        self.connected = False
        self._destroy_all_but(self._kept.pop())
        self.get_logger().info("inactive")
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release."""
        self.release()
        self._destroy_all_but(self._kept.pop())
        self.get_logger().info("cleaned up")
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Disconnect and release, from whatever state."""
        self.connected = False
        while self._kept:
            if len(self._kept) == 1:
                self.release()
            self._destroy_all_but(self._kept.pop())
        self.get_logger().info("shut down")
        return TransitionCallbackReturn.SUCCESS

    def _made(self) -> list[Any]:
        """Everything that this node has in the graph now."""
        kinds = (self.timers, self.subscriptions, self.services, self.clients, self.publishers)
        return [entity for kind in kinds for entity in kind]

    def _destroy_all_but(self, kept: list[Any]) -> None:
        by_kind: list[tuple[Iterable[Any], Callable[[Any], Any]]] = [
            (self.timers, self.destroy_timer),
            (self.subscriptions, self.destroy_subscription),
            (self.services, self.destroy_service),
            (self.clients, self.destroy_client),
            (self.publishers, self.destroy_publisher),
        ]
        for entities, destroy in by_kind:
            for entity in list(entities):
                if not any(entity is other for other in kept):
                    destroy(entity)
