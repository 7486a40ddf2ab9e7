# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Messages from anywhere, and nodes that fall silent, in a real graph of all three nodes."""

import signal
from itertools import cycle

import numpy as np
import pytest
from support.malformed import MALFORMED
from support.ros_graph import RosGraph

from gtmr_model import Helix, Tower, Vehicle
from gtmr_model.dynamics import ROTORS
from gtmr_msgs_py import topics
from gtmr_msgs_py.messages import odometry, rotor_command, rotor_states
from gtmr_msgs_py.node import diagnostics

START = Helix().initial_state(Tower(), Vehicle.paper())
LATER_NS = 10**9
GOOD = (
    (topics.ODOM, odometry.pack(LATER_NS, START)),
    (topics.ROTOR_STATES, rotor_states.pack(LATER_NS, START[ROTORS])),
    (
        topics.ROTOR_COMMAND,
        rotor_command.pack(
            LATER_NS, 25_000_000, np.tile(START[ROTORS], (21, 1)), np.zeros((20, 6))
        ),
    ),
)


class Flight:
    """All three nodes, flying, and what they say of themselves."""

    def __init__(self, graph):
        self.graph = graph
        graph.listen([topics.DIAGNOSTICS, topics.GUARD, topics.ODOM])
        self.processes = {
            name: graph.start(f"gtmr_{name}.node") for name in ("sim", "nmpc", "monitor")
        }
        graph.wait_until(lambda: self.time_ns() > 0)
        graph.wait_until(lambda: all(self.figures(name) for name in self.processes))

    def time_ns(self):
        received = self.graph.received["odom"]
        return odometry.decode(received[-1])[0] if received else -1

    def _status(self, name):
        for msg in reversed(self.graph.received["/diagnostics"]):
            if msg.status[0].name.startswith(name):
                return msg.status[0]
        return None

    def message(self, name):
        status = self._status(name)
        return "" if status is None else status.message

    def figures(self, name):
        status = self._status(name)
        return {} if status is None else diagnostics.decode(status)

    def goes_on(self):
        """Fly on for a while."""
        now_ns = self.time_ns()
        self.graph.wait_until(lambda: self.time_ns() > now_ns + 500_000_000)


@pytest.fixture(scope="module")
def flight():
    with RosGraph() as graph:
        flight = Flight(graph)
        yield flight
        for each in flight.processes.values():
            each.process.send_signal(signal.SIGCONT)


def test_malformed_messages_end_no_node_and_are_counted(flight):
    # Whoever listens to these beside the three nodes is not as careful.
    received = flight.graph.received
    onlooker = [s for s in flight.graph.node.subscriptions if s.topic_name == "/odom"]
    for subscription in onlooker:
        flight.graph.node.destroy_subscription(subscription)
    publishers = {topic.name: topic.publisher(flight.graph.node) for topic, _ in GOOD}
    bad = [
        (publishers[topic.name], kind(good))
        for kind in MALFORMED.values()
        for topic, good in GOOD
        if kind(good)
    ]
    said = cycle(bad)

    def counted():
        for _ in range(4):
            publisher, data = next(said)
            publisher.publish(data)
        return all(flight.figures(name)["dropped_undecodable"] >= 13 for name in flight.processes)

    flight.graph.wait_until(counted)
    for publisher in publishers.values():
        flight.graph.node.destroy_publisher(publisher)
    topics.ODOM.subscription(flight.graph.node, received["odom"].append, topics.NEWEST)
    flight.goes_on()
    assert [each.process.poll() for each in flight.processes.values()] == [None] * 3
    assert not any("Traceback" in each.output for each in flight.processes.values())
    assert not any(flight.figures(name)["callback_errors"] for name in flight.processes)


def test_a_controller_that_falls_silent_is_told_and_the_guard_takes_charge(flight):
    nmpc, guard = flight.processes["nmpc"], flight.graph.received["guard"]
    nmpc.process.send_signal(signal.SIGSTOP)
    flight.graph.wait_until(lambda: "no rotor_command for" in flight.processes["sim"].output)
    flight.graph.wait_until(lambda: guard[-1].data)
    flight.graph.wait_until(lambda: "the guard is in charge" in flight.message("sim"))
    assert flight.figures("sim")["guard"] is True
    nmpc.process.send_signal(signal.SIGCONT)
    flight.graph.wait_until(lambda: not guard[-1].data)
    flight.graph.wait_until(lambda: "rotor_command again" in flight.processes["sim"].output)
    flight.graph.wait_until(lambda: "guard" not in flight.message("sim"))
    assert flight.figures("sim")["guard_time_s"] > 0.0


def test_a_simulator_that_falls_silent_is_told_by_both_that_listen(flight):
    flight.processes["sim"].process.send_signal(signal.SIGSTOP)
    for name, topic in (("nmpc", "odometry"), ("monitor", "/odom")):
        output = f"no {topic} for"
        flight.graph.wait_until(lambda n=name, said=output: said in flight.processes[n].output)
        flight.graph.wait_until(lambda n=name: "odometry has stopped" in flight.message(n))
    flight.processes["sim"].process.send_signal(signal.SIGCONT)
    flight.graph.wait_until(lambda: "odometry again" in flight.processes["nmpc"].output)
    flight.goes_on()
