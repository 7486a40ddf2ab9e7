# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""No message ends a node: what cannot be used is dropped and counted by its cause."""

from inspect import signature
from itertools import chain
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from support.loop_messages import rotor_states_message
from support.malformed import MALFORMED

from gtmr_model import Helix, Tower, Vehicle
from gtmr_model.dynamics import ROTORS
from gtmr_monitor.node import MonitorNode
from gtmr_msgs_py import topics
from gtmr_msgs_py.contract import Frames
from gtmr_msgs_py.messages import odometry, rotor_command, rotor_states
from gtmr_msgs_py.node import diagnostics
from gtmr_msgs_py.wire import stamps
from gtmr_msgs_py.wire.message_error import CAUSES
from gtmr_msgs_py.wire.order import END_NS
from gtmr_nmpc.node import NmpcNode
from gtmr_sim.node import SimNode

NODES = {"nmpc": NmpcNode, "sim": SimNode, "monitor": MonitorNode}
START = Helix().initial_state(Tower(), Vehicle.paper())
NOW_NS = 10**10
TICK_NS = 25_000_000
U = np.zeros((20, 6))
INFO = dict.fromkeys(("received_timestamp", "source_timestamp", "publication_sequence_number"), 0)
"""What the middleware tells of a message."""
XI = np.tile(START[ROTORS], (21, 1))


class Hearing:
    """A node in this process, whose subscriptions hear what the test says."""

    def __init__(self, name, **parameters):
        given = chain.from_iterable(("-p", f"{k}:={v}") for k, v in parameters.items())
        # Simulated time is one more subscription, made by rclpy.
        rclpy.init(args=["--ros-args", "-p", "use_sim_time:=true", *given], domain_id=101)
        self.node = NODES[name](False)
        self.node.start()

    def hear(self, topic, data):
        """Say something on a topic, as the middleware would."""
        name = self.node.resolve_topic_name(topic.name)
        subscriptions = [s for s in self.node.subscriptions if s.topic_name == name]
        assert subscriptions, name
        for subscription in subscriptions:
            info = dict(INFO)
            wants_info = len(signature(subscription.callback).parameters) == 2
            subscription.callback(data, *[info] * wants_info)

    def hears(self, topic):
        """Whether it listens to a topic."""
        name = self.node.resolve_topic_name(topic.name)
        return any(s.topic_name == name for s in self.node.subscriptions)

    def dropped(self):
        """Counts by cause, of all that the node counts."""
        drops = [self.node.drops, *(v.drops for v in getattr(self.node, "_vehicles", []))]
        return {cause: n for cause in CAUSES if (n := sum(d.counts[cause] for d in drops))}

    def close(self):
        self.node.destroy_node()
        rclpy.shutdown()


@pytest.fixture
def hearing():
    made = []

    def start(name, **parameters):
        made.append(Hearing(name, **parameters))
        return made[-1]

    yield start
    for each in made:
        each.close()


def state(stamp_ns, x=START):
    return (topics.ODOM, odometry.pack(stamp_ns, x)), (
        topics.ROTOR_STATES,
        rotor_states.pack(stamp_ns, x[ROTORS]),
    )


def command(stamp_ns, u=U):
    return topics.ROTOR_COMMAND, rotor_command.pack(stamp_ns, TICK_NS, XI, u)


NOT_FINITE = np.where(np.isin(np.arange(18), [1, 13]), np.nan, START)


@pytest.mark.parametrize("name", NODES)
def test_what_is_no_message_is_counted_and_the_node_goes_on(hearing, name):
    node = hearing(name)
    kinds = [
        (topic, kind(good))
        for topic, good in (*state(NOW_NS), command(0))
        for kind in MALFORMED.values()
        if node.hears(topic)
    ]
    kinds += [said for said in state(NOW_NS, NOT_FINITE) if node.hears(said[0])]
    if name == "sim":
        kinds.append(command(0, np.full((20, 6), np.inf)))
    for k, (topic, data) in enumerate(kinds, start=1):
        node.hear(topic, data)
        assert sum(node.dropped().values()) == k, data[:20]
    assert node.dropped().keys() <= {"undecodable", "future", "frame", "vehicle"}
    assert node.node.callback_errors == 0


@pytest.mark.parametrize("name", NODES)
def test_nothing_that_is_said_on_any_topic_ends_a_callback_with_an_exception(hearing, name):
    node = hearing(name)
    good = serialize_message(Clock())
    for subscription in list(node.node.subscriptions):
        for kind in MALFORMED.values():
            info = [dict(INFO)]
            count = len(signature(subscription.callback).parameters)
            subscription.callback(kind(good + bytes(40)), *info[: count - 1])
    assert node.dropped()["undecodable"] > 0


@pytest.mark.parametrize("name", ["nmpc", "monitor"])
@pytest.mark.parametrize("named", [Frames(), Frames("earth", "hex1")])
def test_odometry_of_foreign_frames_is_dropped_unless_they_are_named(hearing, name, named):
    node = hearing(name, world_frame=named.world, body_frame=named.body)
    foreign = [Frames("odom"), Frames(body="hex2/base_link"), Frames("", ""), Frames("earth")]
    for k, frames in enumerate(foreign, start=1):
        node.hear(topics.ODOM, odometry.pack(NOW_NS, START, frames))
        assert node.dropped() == {"frame": k}
    node.hear(topics.ODOM, odometry.pack(NOW_NS, START, named))
    assert node.dropped() == {"frame": len(foreign)}


def test_rotor_speeds_of_another_vehicle_are_dropped(hearing):
    node = hearing("nmpc")
    node.hear(topics.ROTOR_STATES, rotor_states.pack(NOW_NS, np.ones(4)))
    renamed = rotor_states_message(NOW_NS, START[ROTORS])
    renamed.name = [f"propeller_{k}" for k in range(6)]
    node.hear(topics.ROTOR_STATES, serialize_message(renamed))
    assert node.dropped() == {"vehicle": 2}


def test_commands_for_another_vehicle_or_of_another_time_are_dropped(hearing):
    node = hearing("sim")
    node.hear(topics.ROTOR_COMMAND, rotor_command.pack(0, TICK_NS, XI[:, :4], U[:, :4]))
    node.hear(topics.ROTOR_COMMAND, rotor_command.pack(0, 2 * TICK_NS, XI, U))
    node.hear(*command(TICK_NS))
    assert node.dropped() == {"vehicle": 1, "undecodable": 1, "future": 1}
    node.hear(*command(0))
    # Again, as an answer to a state that was published again.
    node.hear(*command(0))
    assert node.dropped() == {"vehicle": 1, "undecodable": 1, "future": 1}


def test_a_stray_of_the_future_or_the_past_neither_stops_the_controller_nor_restarts_it(hearing):
    node = hearing("nmpc")
    strays = (2 * NOW_NS, END_NS, 0, NOW_NS // 2, NOW_NS - TICK_NS)
    for k in range(20):
        for said in state(NOW_NS + k * TICK_NS):
            node.hear(*said)
        if 1 <= k <= len(strays):
            for said in state(strays[k - 1]):
                node.hear(*said)
    assert node.dropped() == {"late": 6, "future": 4}
    assert node.node._performance.steps == 20
    assert node.node._schedule.skipped == 0


@pytest.mark.parametrize("stray_ns", [0, NOW_NS // 2, NOW_NS - TICK_NS, 2 * NOW_NS, END_NS])
def test_no_stray_makes_the_monitor_forget_a_violation(hearing, stray_ns):
    node = hearing("monitor")
    inside = START.copy()
    inside[:2] *= 1.1 / np.linalg.norm(inside[:2])
    for k, x in enumerate([inside, START, START]):
        node.hear(topics.ODOM, odometry.pack(NOW_NS + k * TICK_NS, x))
        node.hear(topics.ODOM, odometry.pack(stray_ns, START))
    (vehicle,) = node.node._vehicles
    assert vehicle.watch.violations == 1
    assert vehicle.late + sum(node.dropped().values()) == 3


def test_an_odometry_that_jumps_is_dropped_and_the_next_is_answered(hearing):
    node = hearing("nmpc")
    elsewhere = START.copy()
    elsewhere[0] += 1.0
    for k, x in enumerate([START, START, elsewhere, START]):
        for said in state(NOW_NS + k * TICK_NS, x):
            node.hear(*said)
    assert node.dropped() == {"jump": 1}
    assert node.node._performance.steps == 3


def told(node):
    """The level, message and figures that a node would publish now."""
    sent = []
    node.node._diagnostics = SimpleNamespace(publish=sent.append)
    node.node._diagnose()
    (status,) = deserialize_message(sent[-1], DiagnosticArray).status
    return status.level, status.message, diagnostics.decode(status)


def test_of_odometry_that_is_too_late_no_command_is_sent_until_it_is_in_time_again(hearing):
    node = hearing("nmpc")
    sent = []
    node.node._rotor_command = SimpleNamespace(publish=sent.append)

    def fly(k, late_ns):
        clock = Clock(clock=stamps.encode(NOW_NS + k * TICK_NS + late_ns))
        node.hear(topics.CLOCK, serialize_message(clock))
        for said in state(NOW_NS + k * TICK_NS):
            node.hear(*said)

    # In lockstep, the state of an instant comes before the clock does.
    for k, late_ns in enumerate([-TICK_NS, -5_000_000, 0, 25_000_000]):
        fly(k, late_ns)
    assert (len(sent), told(node)[2]["delay_s"]) == (4, 0.025)
    for k in range(4, 8):
        fly(k, 50_000_000)
    level, message, figures = told(node)
    assert (len(sent), level, message) == (
        4,
        b"\x02",
        "no command is sent: odometry is 0.05 s late",
    )
    assert (figures["delay_s"], figures["withheld_commands"]) == (0.05, 4)
    fly(8, 0)
    assert (len(sent), told(node)[2]["delay_s"]) == (5, 0)


def test_a_plan_that_is_not_fit_is_not_sent_and_that_is_told(hearing):
    node = hearing("nmpc")
    sent = []
    node.node._rotor_command = SimpleNamespace(publish=sent.append)
    inverted = START.copy()
    inverted[3] = np.pi
    for _ in range(2):
        for said in state(NOW_NS, inverted):
            node.hear(*said)
    assert not sent
    assert told(node)[:2] == (b"\x02", "no command is sent: the vehicle is inverted")
