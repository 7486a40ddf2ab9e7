# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""The monitor as a ROS 2 node: watches the clearance residual and records the flight."""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, ClassVar

from nav_msgs.msg import Odometry
from pydantic import Field, field_validator
from rcl_interfaces.msg import Parameter, ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_parameter_events
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from gtmr_model import ConfigError, Tower, YamlModel
from gtmr_monitor.bag import BagError, without_tail
from gtmr_monitor.bag_writer import BagWriter, OfferedQos
from gtmr_monitor.residual import ResidualWatch
from gtmr_msgs_py import clearance, diagnostics, odometry, topics
from gtmr_msgs_py.diagnostics import Level
from gtmr_msgs_py.message_error import MessageError
from gtmr_msgs_py.parameters import ModelParameters
from gtmr_msgs_py.process import run
from gtmr_msgs_py.suite_node import SuiteNode

DIAGNOSTICS_PERIOD_S = 1.0
"""Between two messages on /diagnostics, wall time [s]."""
FLUSH_PERIOD_S = 0.5
"""Between two flushes of the bag where no messages come that would cause one, wall time [s]."""
PARAMETERS_PERIOD_S = 0.1
"""Between two looks for nodes whose parameters are not yet in the bag, wall time [s]."""
WARNING_PERIOD_S = 5.0
"""Least time between two warnings about the same [s]."""
FROM_ANY_ESTIMATOR = (Odometry, JointState)
"""Messages that on a real vehicle come from elsewhere, often best effort."""
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""What is asked for where a publisher offers no more."""
NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""Every event handler is one more thing to wait for, at every message of any topic."""
NAMESPACE = re.compile(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
"""What may stand before the topics of a vehicle."""
PARAMETER_EVENTS = "/parameter_events"
PARAMETER_EVENT = "rcl_interfaces/msg/ParameterEvent"


class MonitorParameters(YamlModel):
    """The parameters of the node."""

    tower: Tower = Tower()
    """What to keep away from."""
    bag: str = ""
    """Folder to record the flight into, new or empty; empty for no recording."""
    namespaces: Annotated[tuple[str, ...], Field(min_length=1)] = ("",)
    """Namespaces of the vehicles to watch and record, below the node's own; empty for its own."""

    @field_validator("namespaces")
    @classmethod
    def _names(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for name in value:
            if name and not NAMESPACE.fullmatch(name):
                raise ValueError(f"{name!r} is no relative namespace, such as hex1 or fleet/hex1")
        if len(set(value)) < len(value):
            raise ValueError("a namespace is named twice")
        return value


class ParameterFetch:
    """Asks a node for all its parameters whenever it appears in the graph.

    Parameters
    ----------
    node : rclpy.node.Node
        Who asks.
    target : str
        Fully qualified name of the node to ask.
    on_parameters : callable
        Gets the answer as an event.
    """

    def __init__(
        self, node: Node, target: str, on_parameters: Callable[[ParameterEvent], None]
    ) -> None:
        self._target = target
        self._on_parameters = on_parameters
        self._list = node.create_client(ListParameters, f"{target}/list_parameters")
        self._get = node.create_client(GetParameters, f"{target}/get_parameters")
        self._asked = False

    def poll(self) -> None:
        """Ask if the node is there and was not asked since it appeared."""
        if not (self._list.service_is_ready() and self._get.service_is_ready()):
            self._asked = False
        elif not self._asked:
            self._asked = True
            self._list.call_async(ListParameters.Request()).add_done_callback(self._on_names)

    def _on_names(self, future: Any) -> None:
        names = future.result().result.names
        answer = self._get.call_async(GetParameters.Request(names=names))
        answer.add_done_callback(partial(self._on_values, names))

    def _on_values(self, names: list[str], future: Any) -> None:
        event = ParameterEvent(node=self._target)
        for name, value in zip(names, future.result().values, strict=True):
            event.new_parameters.append(Parameter(name=name, value=value))
        self._on_parameters(event)


class Vehicle:
    """One of the vehicles that a monitor watches: its residual, and what is published of it.

    Parameters
    ----------
    node : rclpy.node.Node
        The monitor.
    namespace : str
        Of the vehicle, relative to the monitor's own; empty for that.
    """

    def __init__(self, node: Node, namespace: str) -> None:
        self.namespace = namespace
        self.watch = ResidualWatch()
        """The residual since the flight began."""
        self.unusable = 0
        """How many odometry messages could not be used."""
        self.odometry_name = node.resolve_topic_name(self.topic(topics.ODOM).name)
        self.clearance = self.topic(topics.CLEARANCE).publisher(node)
        self.residual = self.topic(topics.CLEARANCE_RESIDUAL).publisher(node)
        self._stamp_ns = 0

    def topic(self, topic: topics.Topic) -> topics.Topic:
        """Return a topic of the suite as this vehicle has it."""
        if not self.namespace or topic.name.startswith("/"):
            return topic
        return replace(topic, name=f"{self.namespace}/{topic.name}")

    def update(self, stamp_ns: int, residual_m: float) -> None:
        """Take in a residual [m]; time that goes back begins another flight."""
        if stamp_ns < self._stamp_ns:
            self.watch = ResidualWatch()
        self._stamp_ns = stamp_ns
        self.watch.update(residual_m)


class MonitorNode(SuiteNode):
    """Publishes clearance and residual for every odometry message, and records every topic.

    Parameters
    ----------
    managed : bool
        Whether lifecycle services say when it watches.

    Raises
    ------
    ConfigError
        If a parameter cannot be used.
    """

    PRESETS: ClassVar[dict[str, str]] = {}
    """Parameters that name a preset or a file, with their defaults."""
    DYNAMIC: ClassVar = {"tower.min_clearance_m"}
    """Parameters that may change in flight."""

    def __init__(self, managed: bool = False) -> None:
        super().__init__("monitor", managed)
        self._settings = ModelParameters(self, MonitorParameters, self.PRESETS, self.DYNAMIC)
        self._bag: BagWriter | None = None

    def allocate(self) -> None:
        """Open the bag, which must be new or empty."""
        self._vehicles = [Vehicle(self, name) for name in self._settings.value.namespaces]
        self._unwritten = 0
        self._bag = self._open_bag(self._settings.value.bag)

        self._status = topics.DIAGNOSTICS.publisher(self)
        self._fetches: list[ParameterFetch] = []

    def connect(self) -> None:
        """Listen."""
        # The flight's time may stand still or run fast; a bag is kept by the wall's.
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._diagnose, clock=wall)
        for vehicle in self._vehicles:
            self._subscribe(vehicle.topic(topics.ODOM), partial(self._on_odometry, vehicle))
        if self._bag is None:
            return
        self._fetches.clear()
        self._record_everything()
        self.create_timer(FLUSH_PERIOD_S, self._flush, clock=wall)
        self.create_timer(PARAMETERS_PERIOD_S, self._poll_parameters, clock=wall)
        self._write_parameters(self._own_parameters())
        self.get_logger().info(f"recording into {self._bag.folder}")

    def release(self) -> None:
        """Close the bag, with what has already arrived."""
        bag = self._bag
        if bag is not None:
            self._take_what_arrived()
            self._bag = None
            try:
                bag.close()
            except BagError as error:
                self.get_logger().error(str(error))

    def destroy_node(self) -> None:
        """Close the bag and take the node out of the graph."""
        self.release()
        super().destroy_node()

    def _topics(self) -> dict[str, topics.Topic]:
        """Every topic of every vehicle by its full name; what is absolute they have in common."""
        return {
            self.resolve_topic_name(topic.name): topic
            for vehicle in self._vehicles
            for topic in map(vehicle.topic, topics.TOPICS)
        }

    def _open_bag(self, folder: str) -> BagWriter | None:
        if not folder:
            return None
        try:
            bag = BagWriter(folder)
        except BagError as error:
            raise ConfigError(f"{self.get_name()}: bag = {error}") from None
        for name, topic in self._topics().items():
            bag.add_topic(name, topic.type_name, _offered(topic.qos))
        bag.add_topic(
            PARAMETER_EVENTS,
            PARAMETER_EVENT,
            _offered(qos_profile_parameter_events),
        )
        return bag

    def _record_everything(self) -> None:
        written_otherwise = {
            name
            for vehicle in self._vehicles
            for name in (
                vehicle.odometry_name,
                vehicle.clearance.topic_name,
                vehicle.residual.topic_name,
            )
        }
        for name, topic in self._topics().items():
            if name not in written_otherwise:
                self._subscribe(topic, partial(self._on_message, name))
        self.create_subscription(
            ParameterEvent,
            PARAMETER_EVENTS,
            partial(self._on_message, PARAMETER_EVENTS),
            qos_profile_parameter_events,
            raw=True,
            event_callbacks=NO_EVENTS,
        )
        publishers = {name for topic in topics.TOPICS for name in topic.publishers}
        for vehicle in self._vehicles:
            parts = (self.get_namespace().strip("/"), vehicle.namespace)
            namespace = "".join(f"/{part}" for part in parts if part)
            for name in sorted(publishers - {self.get_name()}):
                self._fetches.append(
                    ParameterFetch(self, f"{namespace}/{name}", self._write_parameters)
                )

    def _subscribe(self, topic: topics.Topic, callback: Callable[..., None]) -> None:
        """Listen so that nothing is lost, or so well as a publisher that is not ours allows."""
        events = NO_EVENTS
        if topic.message in FROM_ANY_ESTIMATOR:
            events = SubscriptionEventCallbacks(
                incompatible_qos=lambda _: self._listen_to_best_effort(reliable, topic, callback),
                use_default_callbacks=False,
            )
        reliable = self.create_subscription(
            topic.message, topic.name, callback, topic.qos, raw=True, event_callbacks=events
        )

    def _listen_to_best_effort(
        self, reliable: Subscription, topic: topics.Topic, callback: Callable[..., None]
    ) -> None:
        """Ask for less: a best-effort subscription gets what either kind of publisher sends."""
        self.get_logger().warning(f"{topic.name} is published best effort: messages may be lost")
        self.destroy_subscription(reliable)
        self.create_subscription(
            topic.message, topic.name, callback, BEST_EFFORT, raw=True, event_callbacks=NO_EVENTS
        )

    def _on_message(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        self._write(topic, data, _received_ns(info), info["source_timestamp"])

    def _on_odometry(self, vehicle: Vehicle, data: bytes, info: dict[str, int]) -> None:
        received_ns = _received_ns(info)
        self._write(vehicle.odometry_name, data, received_ns, info["source_timestamp"])
        tower = self._settings.value.tower
        try:
            stamp_ns, x = odometry.decode(deserialize_message(data, Odometry))
        except MessageError as error:
            vehicle.unusable += 1
            self.get_logger().warning(f"ignored: {error}", throttle_duration_sec=WARNING_PERIOD_S)
            return
        residual_m = float(tower.residual(x))
        vehicle.update(stamp_ns, residual_m)
        distance = clearance.encode(stamp_ns, float(tower.clearance(x)), tower.min_clearance_m)
        # With the odometry's time in the bag, so that they stay together.
        self._publish(vehicle.clearance, distance, received_ns)
        self._publish(vehicle.residual, clearance.encode_residual(residual_m), received_ns)

    def _publish(self, publisher: Publisher, message: Any, log_time_ns: int) -> None:
        data = serialize_message(message)
        # First into the bag: a Ctrl-C may come between the two.
        self._write(publisher.topic_name, data, log_time_ns)
        if self.context.ok():
            publisher.publish(data)

    def _write(
        self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        if self._bag is None:
            self._unwritten += bool(self._settings.value.bag)
            return
        try:
            self._bag.write(topic, data, log_time_ns, publish_time_ns)
        except BagError as error:
            self._stop_recording(error)

    def _flush(self) -> None:
        if self._bag is not None:
            try:
                self._bag.flush()
            except BagError as error:
                self._stop_recording(error)

    def _stop_recording(self, error: BagError) -> None:
        """Fly on without a bag: a full disk is no reason to stop watching."""
        self._bag = None
        self._unwritten += 1
        self.get_logger().error(f"stopped recording: {error}")

    def _poll_parameters(self) -> None:
        for fetch in self._fetches:
            fetch.poll()

    def _own_parameters(self) -> ParameterEvent:
        names = self.list_parameters([], 0).names
        parameters = [p.to_parameter_msg() for p in self.get_parameters(names)]
        return ParameterEvent(node=self.get_fully_qualified_name(), new_parameters=parameters)

    def _write_parameters(self, event: ParameterEvent) -> None:
        event.stamp = self.get_clock().now().to_msg()
        data = without_tail(serialize_message(event), PARAMETER_EVENT)
        self._write(PARAMETER_EVENTS, data, time.time_ns())
        self._flush()

    def _take_what_arrived(self) -> None:
        for subscription in self.subscriptions:
            with subscription.handle:
                while taken := subscription.handle.take_message(
                    subscription.msg_type, subscription.raw
                ):
                    subscription.callback(*taken)

    def _diagnose(self) -> None:
        for vehicle in self._vehicles:
            self._diagnose_vehicle(vehicle)

    def _diagnose_vehicle(self, vehicle: Vehicle) -> None:
        watch, recording = vehicle.watch, self._bag is not None
        level, message = Level.OK, "clear of the tower"
        if self._unwritten:
            level, message = Level.ERROR, "stopped recording: the bag cannot be written"
        elif watch.current_m > 0.0:
            level, message = Level.ERROR, "the clearance is violated"
        elif watch.samples == 0:
            level, message = Level.STALE, "no odometry"
        elif watch.violations:
            level, message = Level.WARN, "the clearance was violated"
        values: dict[str, diagnostics.Value] = {
            "min_clearance_m": self._settings.value.tower.min_clearance_m,
            "violations": watch.violations,
            "samples": watch.samples,
            "unusable_odometry": vehicle.unusable,
            "recording": recording,
            "bag": self._settings.value.bag,
            "messages_written": self._bag.messages if self._bag is not None else 0,
            "bag_bytes": self._bag.size_bytes if self._bag is not None else 0,
            "messages_not_written": self._unwritten,
        }
        if math.isfinite(watch.worst_m):
            values |= {"residual_m": watch.current_m, "worst_residual_m": watch.worst_m}
        what = f"{vehicle.namespace} clearance" if vehicle.namespace else "clearance"
        self._status.publish(
            diagnostics.encode(
                self.get_clock().now().nanoseconds,
                f"{diagnostics.source(self)}: {what}",
                level,
                message,
                values,
            )
        )


def _received_ns(info: dict[str, int]) -> int:
    """When the middleware got the message, as callbacks may wait; not all of them tell."""
    return info["received_timestamp"] or time.time_ns()


def _offered(qos: QoSProfile) -> OfferedQos:
    return OfferedQos(
        depth=qos.depth,
        reliability="best_effort" if qos.reliability.name == "BEST_EFFORT" else "reliable",
        durability="transient_local" if qos.durability.name == "TRANSIENT_LOCAL" else "volatile",
    )


def main(args: list[str] | None = None) -> int:
    """Run the node ``monitor``.

    Parameters
    ----------
    args : list of str, optional
        Command line with ROS arguments; ``sys.argv`` if left out.

    Returns
    -------
    int
        Exit code: 0 after SIGINT or SIGTERM, 2 for a bad parameter.
    """
    return run(MonitorNode, args)


if __name__ == "__main__":
    sys.exit(main())
