# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Flights of real nodes that the real monitor recorded, each flown once in a test run."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from gtmr_msgs_py import topics
from gtmr_msgs_py.messages import odometry
from gtmr_msgs_py.wire import stamps
from gtmr_nmpc import Controller
from gtmr_sim import Scenario, fly
from support.ros_graph import RosGraph

FOLDER = tempfile.TemporaryDirectory(prefix="gtmr_test_bags_")
DURATION_S = 1.5


@cache
def recorded(name: str, mode: str = "robust", real_time: bool = False, switch: str = "") -> Path:
    """Fly, record, and give the bag; a switch of the mode in flight comes with another weight."""
    bag = Path(tempfile.mkdtemp(dir=FOLDER.name)) / name
    # What is compiled once for a machine must not be so in flight.
    fly(Scenario(), Controller(), 0.05)
    with RosGraph() as graph:
        graph.listen([topics.ODOM])
        monitor = graph.start("gtmr_monitor.node", bag=str(bag))
        graph.start("gtmr_nmpc.node", mode=mode, recorders="1")
        # Found before the flight, which does not wait.
        client = graph.parameters_of("nmpc") if switch else None
        sim = graph.start(
            "gtmr_sim.node",
            lockstep=str(not real_time).lower(),
            seed="5",
            sample_zeta="true",
            duration_s=str(DURATION_S),
            recorders="1",
        )

        def flown_s():
            received = graph.received["odom"]
            return stamps.seconds(odometry.decode(received[-1])[0]) if received else 0.0

        if switch:
            graph.wait_until(lambda: flown_s() > 0.5)
            assert graph.set_parameter("nmpc", "mode", switch, client).successful
            graph.wait_until(lambda: flown_s() > 0.8)
            assert graph.set_parameter("nmpc", "weights.yaw", 30.0, client).successful
        graph.wait_until(lambda: sim.process.poll() is not None)
        assert sim.process.returncode == 0, (sim.process.returncode, sim.output)
        assert monitor.interrupt() == 0, monitor.output
    return bag
