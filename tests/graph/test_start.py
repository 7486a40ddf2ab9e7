# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Nodes that are brought up by their lifecycle services, and one that comes back in flight."""

import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from support.ros_graph import RosGraph

from gtmr_model import Tower
from gtmr_msgs_py import topics
from gtmr_msgs_py.messages import odometry
from gtmr_msgs_py.start.environment import ros_environment
from gtmr_msgs_py.wire import stamps

SIM, NMPC = "gtmr_sim.node", "gtmr_nmpc.node"

STUBBORN = """
import sys
from gtmr_model import ConfigError
from gtmr_msgs_py.node.process import run
from gtmr_msgs_py.node.suite_node import SuiteNode

class Stubborn(SuiteNode):
    def allocate(self):
        raise ConfigError("no such vehicle")

sys.exit(run(lambda managed: Stubborn("stubborn", managed), ["--managed"]))
"""


@pytest.fixture
def graph() -> Iterator[RosGraph]:
    with RosGraph() as graph:
        yield graph


def flown_s(graph):
    received = graph.received["odom"]
    return stamps.decode(received[-1].header.stamp) * 1e-9 if received else 0.0


def brought_up(graph, name):
    """Exit code and last words of what brings a node up."""
    run = subprocess.run(
        [sys.executable, "-m", "gtmr_msgs_py.start.bring_up", name],
        env=ros_environment(graph.domain_id),
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    return run.returncode, run.stderr


def test_a_managed_node_is_brought_up_from_any_state_unless_it_refuses(graph):
    graph.start(SIM, options=["--managed"])
    assert brought_up(graph, "/sim") == (0, "")
    assert brought_up(graph, "/sim") == (0, "")
    state = graph.call(GetState, "sim/get_state", GetState.Request()).current_state
    assert state.id == State.PRIMARY_STATE_ACTIVE
    with subprocess.Popen(
        [sys.executable, "-c", STUBBORN], env=ros_environment(graph.domain_id),
        stderr=subprocess.PIPE, text=True,
    ) as node:  # fmt: skip
        refused = brought_up(graph, "/stubborn")
        node.send_signal(signal.SIGINT)
        assert "no such vehicle" in node.stderr.read()
    assert refused == (1, "error: /stubborn cannot be made active: its log says why\n")


@pytest.mark.parametrize("lockstep", ["true", "false"])
def test_a_controller_that_was_killed_is_let_in_again_in_the_middle_of_a_flight(graph, lockstep):
    graph.listen([topics.ODOM, topics.ROTOR_COMMAND])
    first = graph.start(NMPC)
    graph.start(SIM, lockstep=lockstep, gust__kind="none")
    graph.wait_until(lambda: flown_s(graph) > 0.5)
    first.process.send_signal(signal.SIGKILL)
    first.process.wait()
    since_s = flown_s(graph)
    graph.received["rotor_command"].clear()
    graph.start(NMPC)
    graph.wait_until(lambda: len(graph.received["rotor_command"]) > 20)
    graph.wait_until(lambda: flown_s(graph) > since_s + 0.5)
    flown = [odometry.decode(message)[1][:3] for message in graph.received["odom"]]
    assert all(Tower().clearance(position) > 0.0 for position in flown)
    # It flies the same flight, not another one from the start.
    stamped = [stamps.decode(message.header.stamp) for message in graph.received["odom"]]
    assert stamped == sorted(stamped)
