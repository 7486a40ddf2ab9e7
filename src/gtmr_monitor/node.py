# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The monitor as a ROS 2 node: watches the clearance residual and records the flight."""

from __future__ import annotations

import math
import re
import sys
import time
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import Field, field_validator
from rcl_interfaces.msg import ParameterEvent
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.parameter import parameter_value_to_python
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from gtmr_model import ConfigError, Tower
from gtmr_monitor.agreement import NAMES, TowerAgreement
from gtmr_monitor.bag.format import BagError, without_tail
from gtmr_monitor.bag.metadata import OfferedQos
from gtmr_monitor.hearing import Gaps, Numbers
from gtmr_monitor.recorder import Recorder
from gtmr_monitor.residual import ResidualWatch
from gtmr_msgs_py import contract, topics
from gtmr_msgs_py.contract import Frames, TopicName
from gtmr_msgs_py.messages import clearance, odometry, transforms
from gtmr_msgs_py.node import diagnostics
from gtmr_msgs_py.node.diagnostics import Level
from gtmr_msgs_py.node.listening import Info, listen, received_ns, take_what_arrived
from gtmr_msgs_py.node.parameter_events import PARAMETER_EVENTS, ParameterFetch, own_parameters
from gtmr_msgs_py.node.parameters import FrameParameters, ModelParameters
from gtmr_msgs_py.node.process import run
from gtmr_msgs_py.node.silence import Silence
from gtmr_msgs_py.node.suite_node import SuiteNode
from gtmr_msgs_py.wire import stamps
from gtmr_msgs_py.wire.drops import Drops
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_msgs_py.wire.order import Place, StampOrder
from gtmr_msgs_py.wire.reading import read

DIAGNOSTICS_PERIOD_S = 1.0
"""Between two messages on /diagnostics, wall time [s]."""
FLUSH_PERIOD_S = 0.5
"""Between two flushes of the bag where no messages come that would cause one, wall time [s]."""
PARAMETERS_PERIOD_S = 0.1
"""Between two looks for nodes whose parameters are not yet in the bag, wall time [s]."""
TRANSFORM_PERIOD_NS = 50_000_000
"""Between two transforms of a vehicle in the bag, odometry time [ns]; viewers interpolate."""
FLYING = sorted({n for topic in topics.TOPICS for n in topic.publishers} - {"monitor"})
"""Nodes of which every vehicle has its own."""
AnyTopic = TypeVar("AnyTopic", bound=TopicName)
NAMESPACE = re.compile(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
"""What may stand before the topics of a vehicle."""


class MonitorParameters(FrameParameters):
    """The parameters of the node."""

    tower: Tower = Tower()
    """What to keep away from."""
    bag: str = ""
    """Folder to record the flight into, new or empty, or with a bag of the same nodes, in which it
    goes on; empty for no recording."""
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


class WatchedVehicle:
    """One of the vehicles that a monitor watches: its residual, and what is published of it.

    Its namespace is relative to that of the node, the monitor; empty for that.
    """

    def __init__(self, node: SuiteNode, namespace: str, frames: Frames) -> None:
        self.node = node
        self.namespace = namespace
        self.watch = ResidualWatch()
        """The residual since the flight began."""
        self.late = 0
        """How many odometry messages came behind newer ones."""
        self.gaps = Gaps()
        """In the odometry since the flight began."""
        self.drops = Drops(lambda reason: node.warn(f"{self.odometry_name}: {reason}"))
        """Its odometry that could not be used."""
        self.odometry_name = node.resolve_topic_name(self.topic(topics.ODOM).name)
        self.clearance = self.topic(topics.CLEARANCE).publisher(node)
        self.residual = self.topic(topics.CLEARANCE_RESIDUAL).publisher(node)
        self.order = StampOrder()
        """Of the odometry."""
        self.silence: Silence | None = None
        """Whether its odometry has stopped, while the node listens."""
        self.towers = TowerAgreement()
        """What the nodes that fly it take for the tower."""
        self.warned: list[str] = []
        """What of that was told in the log."""
        self.truth_name = node.resolve_topic_name(self.topic(topics.GROUND_TRUTH).name)
        self.tf_name = node.resolve_topic_name(self.topic(contract.TF).name)
        self._frames = frames
        self._transform_ns: int | None = None
        self.source = topics.ODOM
        """Where its clearance comes from: what is true, where somebody tells it."""
        parts = (node.get_namespace().strip("/"), namespace)
        above = "".join(f"/{part}" for part in parts if part)
        self.nodes = {f"{above}/{name}": name for name in FLYING}
        """Short names of these nodes by full name."""

    def topic(self, topic: AnyTopic) -> AnyTopic:
        """Return a topic of the suite as this vehicle has it."""
        if not self.namespace or topic.name.startswith("/"):
            return topic
        return replace(topic, name=f"{self.namespace}/{topic.name}")

    @property
    def is_silent(self) -> bool:
        """Whether what its clearance comes from has stopped."""
        return self.silence is not None and self.silence.silent

    def record_transform(self, bag: Recorder, stamp_ns: int, x: Any, log_time_ns: int) -> None:
        """Write where it is into the bag, of a state [p, eta, ...], where nobody publishes it."""
        last_ns = self._transform_ns
        # Time goes back where a flight begins again.
        due = last_ns is None or not 0 <= stamp_ns - last_ns < TRANSFORM_PERIOD_NS
        if topics.TF is None and due:
            self._transform_ns = stamp_ns
            bag.write(self.tf_name, transforms.pack(stamp_ns, x, self._frames), log_time_ns)

    def take_from(self, source: topics.Topic) -> None:
        """Take the clearance from another topic from now on, and begin to count again."""
        if source != self.source:
            self.source, self.order = source, StampOrder()
            self.watch, self.gaps, self.late = ResidualWatch(), Gaps(), 0

    def update(self, stamp_ns: int, residual_m: float) -> ResidualWatch | None:
        """Take in a residual [m]; of a flight that another one follows, return the watch.

        Raises MessageError if the stamp is of another time than all around it.
        """
        place, ended = self.order.place(stamp_ns), None
        if place in (Place.PAST, Place.FUTURE):
            raise self.order.refusal(place, stamp_ns)
        if place is Place.RESET:
            ended, self.watch, self.late = self.watch, ResidualWatch(), 0
            self.gaps = Gaps()
        self.late += place is Place.LATE
        if place is not Place.LATE and self.gaps.take(stamp_ns):
            self.node.warn(
                f"{self.odometry_name}: gaps so far: {self.gaps.count}, "
                f"{self.gaps.missing_s:.2f} s in all"
            )
        self.watch.update(residual_m, late=place is Place.LATE)
        return ended


class MonitorNode(SuiteNode):
    """Publishes clearance and residual for every odometry message, and records every topic.

    If it is ``managed``, lifecycle services say when it watches. Raises ConfigError if a parameter
    cannot be used.
    """

    PRESETS: ClassVar[dict[str, str]] = {}
    """Parameters that name a preset or a file, with their defaults."""
    DYNAMIC: ClassVar = {"tower.min_clearance_m"}
    """Parameters that may change in flight."""

    def __init__(self, managed: bool = False) -> None:
        super().__init__("monitor", managed)
        self._settings = ModelParameters(self, MonitorParameters, self.PRESETS, self.DYNAMIC)
        self._recording = Recorder("", {}, self._say)
        self._numbers = Numbers()

    def allocate(self) -> None:
        """Open the bag."""
        settings = self._settings.value
        self._vehicles = [
            WatchedVehicle(self, name, settings.frames) for name in settings.namespaces
        ]
        self._numbers = Numbers()
        self._of_one = {
            name for name, topic in self._topics().items() if len(topic.publishers) == 1
        }
        self._recording = self._record_into(settings.bag)
        self._status = topics.DIAGNOSTICS.publisher(self)

    def connect(self) -> None:
        """Listen."""
        # The flight's time may stand still or run fast; a bag is kept by the wall's.
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._diagnose, clock=wall)
        for vehicle in self._vehicles:
            vehicle.silence = Silence(
                self, vehicle.odometry_name, partial(self._diagnose_vehicle, vehicle)
            )
            for source in (topics.ODOM, topics.GROUND_TRUTH):
                take = partial(self._on_odometry, vehicle, source)
                listen(self, vehicle.topic(source), take)
        listen(self, PARAMETER_EVENTS, self._on_parameter_event)
        self._fetches = [
            ParameterFetch(self, name, self._take_parameters)
            for vehicle in self._vehicles
            for name in vehicle.nodes
        ]
        self.create_timer(PARAMETERS_PERIOD_S, self._poll_parameters, clock=wall)
        if not self._recording.folder:
            return
        self._recording.write(
            contract.TF_STATIC.name,
            transforms.pack_tower(self._settings.value.frames),
            time.time_ns(),
        )
        self._record_everything()
        self.create_timer(FLUSH_PERIOD_S, self._recording.flush, clock=wall)
        self._take_parameters(own_parameters(self))
        self.get_logger().info(f"recording into {self._recording.folder}")

    def release(self) -> None:
        """Close the bag, with what has already arrived."""
        if self._recording.active:
            take_what_arrived(self)
        ended, self._recording = self._recording, Recorder("", {}, self._say)
        ended.close()

    def destroy_node(self) -> None:
        """Close the bag and take the node out of the graph."""
        self.release()
        super().destroy_node()

    def _topics(self) -> dict[str, topics.Topic]:
        """All there is to record, by full name; what is absolute the vehicles have in common."""
        of_vehicles = {
            self.resolve_topic_name(topic.name): topic
            for vehicle in self._vehicles
            for topic in map(vehicle.topic, topics.TOPICS)
        }
        return {**of_vehicles, PARAMETER_EVENTS.name: PARAMETER_EVENTS}

    def _say(self, reason: str) -> None:
        self.get_logger().error(reason)

    def _record_into(self, folder: str) -> Recorder:
        recorded = {
            name: (topic.type_name, _offered(topic.qos)) for name, topic in self._topics().items()
        }
        if topics.TF is None:
            tf = (contract.TF.type_name, OfferedQos())
            recorded |= {vehicle.tf_name: tf for vehicle in self._vehicles}
        latched = OfferedQos(depth=1, durability="transient_local")
        recorded[contract.TF_STATIC.name] = (contract.TF_STATIC.type_name, latched)
        try:
            return Recorder(folder, recorded, self._say)
        except BagError as error:
            raise ConfigError(f"{self.get_name()}: bag = {error}") from None

    def _record_everything(self) -> None:
        written_otherwise = {PARAMETER_EVENTS.name}
        for v in self._vehicles:
            own = (v.odometry_name, v.truth_name, v.clearance.topic_name, v.residual.topic_name)
            written_otherwise.update(own)
        for name, topic in self._topics().items():
            if name not in written_otherwise:
                listen(self, topic, partial(self._on_message, name))

    def _on_message(self, topic: str, data: bytes, info: Info) -> None:
        self._numbers.take(topic, self._number(topic, info))
        self._recording.write(topic, data, received_ns(info), info["source_timestamp"])

    def _number(self, topic: str, info: Info) -> int | None:
        """Tell which of its publisher's messages it is; None where there are several of them."""
        return info["publication_sequence_number"] if topic in self._of_one else None

    def _on_parameter_event(self, data: bytes, info: Info) -> None:
        self._on_message(PARAMETER_EVENTS.name, data, info)
        self._compare(read(data, ParameterEvent))

    def _compare(self, event: ParameterEvent) -> None:
        """Take in what a node of a vehicle takes for the tower."""
        told = [p for p in (*event.new_parameters, *event.changed_parameters) if p.name in NAMES]
        values = {p.name: parameter_value_to_python(p.value) for p in told}
        for vehicle in self._vehicles:
            if event.node in vehicle.nodes:
                vehicle.towers.take(vehicle.nodes[event.node], values)

    def _on_odometry(
        self, vehicle: WatchedVehicle, source: topics.Topic, data: bytes, info: Info
    ) -> None:
        is_truth, came_ns = source is topics.GROUND_TRUTH, received_ns(info)
        name = vehicle.truth_name if is_truth else vehicle.odometry_name
        self._numbers.take(name, self._number(name, info))
        self._recording.write(name, data, came_ns, info["source_timestamp"])
        if is_truth or (
            vehicle.source is topics.ODOM and self.count_publishers(vehicle.truth_name)
        ):
            vehicle.take_from(topics.GROUND_TRUTH)
        elif vehicle.is_silent and not self.count_publishers(vehicle.truth_name):
            # Who told the truth has gone, and the flight goes on without.
            vehicle.take_from(topics.ODOM)
        is_source = source is vehicle.source
        if is_source and vehicle.silence is not None:
            vehicle.silence.heard()
        try:
            if is_source:
                self._watch(vehicle, data, came_ns)
            else:
                # Not needed, but one that cannot be used is told of all the same.
                odometry.unpack(data, self._settings.value.frames)
        except MessageError as error:
            vehicle.drops.add(error)

    def _watch(self, vehicle: WatchedVehicle, data: bytes, came_ns: int) -> None:
        settings = self._settings.value
        tower = settings.tower
        stamp_ns, x = odometry.unpack(data, settings.frames)
        residual_m = float(tower.residual(x))
        vehicle.record_transform(self._recording, stamp_ns, x, came_ns)
        begins = vehicle.order.newest_ns is None
        ended = vehicle.update(stamp_ns, residual_m)
        if ended is not None:
            self.get_logger().info(
                f"another flight begins at {stamps.seconds(stamp_ns):g} s; the one before had "
                f"{ended.violations} violations, residual at most {ended.worst_m:.3f} m"
            )
        if begins or ended is not None:
            self.tell_parameters()
        distance = clearance.encode(stamp_ns, float(tower.clearance(x)), settings.body_frame)
        # With the odometry's time in the bag, so that they stay together.
        self._publish(vehicle.clearance, distance, came_ns)
        self._publish(vehicle.residual, clearance.encode_residual(residual_m), came_ns)

    def _publish(self, publisher: Publisher, message: Any, log_time_ns: int) -> None:
        data = serialize_message(message)
        self._recording.write(publisher.topic_name, data, log_time_ns)
        publisher.publish(data)

    def _poll_parameters(self) -> None:
        for fetch in self._fetches:
            fetch.poll()

    def _take_parameters(self, event: ParameterEvent) -> None:
        self._compare(event)
        event.stamp = self.get_clock().now().to_msg()
        data = without_tail(serialize_message(event), PARAMETER_EVENTS.type_name)
        self._recording.write(PARAMETER_EVENTS.name, data, time.time_ns())
        self._recording.flush()

    def _diagnose(self) -> None:
        for vehicle in self._vehicles:
            self._diagnose_vehicle(vehicle)

    def _diagnose_vehicle(self, vehicle: WatchedVehicle) -> None:
        watch, recording, tower = vehicle.watch, self._recording, self._settings.value.tower
        level, message = Level.OK, "clear of the tower"
        if recording.stopped:
            level, message = Level.ERROR, "stopped recording: the bag cannot be written"
        elif watch.current_m > 0.0:
            level, message = Level.ERROR, "the clearance is violated"
        elif watch.samples == 0:
            level, message = Level.STALE, "no odometry"
        elif watch.violations:
            level, message = Level.WARN, "the clearance was violated"
        elif recording.resumed:
            level, message = Level.WARN, f"{message} since this monitor was started"
        if recording.unwritten and not recording.stopped:
            level = max(level, Level.WARN)
            message += "; some messages are not in the bag"
        if recording.resumed:
            message += "; what was before is in the bag"
        if vehicle.gaps.count or self._numbers.lost:
            level = max(level, Level.WARN)
            message += "; not everything was heard"
        if vehicle.is_silent:
            level = Level.WARN if level is Level.OK else level
            message += "; odometry has stopped"
        if vehicle.late:
            message += "; some odometry came late"
        vehicle.towers.take(
            self.get_name(), dict(zip(NAMES, (tower.radius_m, tower.min_clearance_m), strict=True))
        )
        disagreements = vehicle.towers.disagreements
        if disagreements:
            level = Level.WARN if level is Level.OK else level
            message = "; ".join([message, *disagreements])
        if disagreements != vehicle.warned:
            vehicle.warned = disagreements
            for disagreement in disagreements:
                self.get_logger().warning(f"the nodes differ: {disagreement}")
        values: dict[str, diagnostics.Value] = {
            "min_clearance_m": tower.min_clearance_m,
            "clearance_from": vehicle.source.name,
            "violations": watch.violations,
            "samples": watch.samples,
            "late_odometry": vehicle.late,
            "odometry_gaps": vehicle.gaps.count,
            "odometry_missing_s": vehicle.gaps.missing_s,
            "messages_not_heard": self._numbers.lost.total(),
            **vehicle.drops.figures(),
            "dropped_beside_odometry": self.drops.counts.total(),
            "callback_errors": self.callback_errors,
            "recording": recording.active,
            "bag": self._settings.value.bag,
            "messages_written": recording.messages,
            "bag_bytes": recording.size_bytes,
            "messages_not_written": recording.unwritten,
        }
        if math.isfinite(watch.worst_m):
            values |= {"residual_m": watch.current_m, "worst_residual_m": watch.worst_m}
        what = f"{vehicle.namespace} clearance" if vehicle.namespace else "clearance"
        name, now_ns = f"{diagnostics.source(self)}: {what}", self.get_clock().now().nanoseconds
        self._status.publish(diagnostics.pack(now_ns, name, level, message, values))


def _offered(qos: QoSProfile) -> OfferedQos:
    return OfferedQos(
        depth=qos.depth,
        reliability="best_effort" if qos.reliability.name == "BEST_EFFORT" else "reliable",
        durability="transient_local" if qos.durability.name == "TRANSIENT_LOCAL" else "volatile",
    )


def main(args: list[str] | None = None) -> int:
    """Run the node ``monitor``: exit code 0 after SIGINT or SIGTERM, 2 for a bad parameter."""
    return run(MonitorNode, args)


if __name__ == "__main__":
    sys.exit(main())
