# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Record bags/sample anew: one flight in real time, in all three modes one after the other.

Run with ``python bench/sample_bag.py`` on an idle machine. The three nodes are processes of their
own, the mode is switched through the controller's parameter, and the bag is taken only if no
command was late and nothing was lost.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rosgraph_msgs.msg import Clock

from gtmr_monitor.bag.flight import read_flight
from gtmr_monitor.bag.reader import read_messages
from gtmr_msgs_py import topics
from gtmr_msgs_py.wire import stamps
from gtmr_nmpc import MODES, Controller, ControllerConfig
from gtmr_study.ros.demo import nodes, watch

SAMPLE = Path(__file__).parents[1] / "bags" / "sample"
"""Where the bag is kept."""
ZETA = (*(0.0,) * 6, 0.6, 0.4, 0.0)
"""The wind of Fig. 1, as in the demo."""
SECONDS_A_MODE = 7.0
"""How long each mode flies, simulated time [s]."""
MOST_BYTES = 5_300_000
"""How large the bag may be: it is in the repository [bytes]."""


class Switches:
    """Switches the mode in flight, each at its time."""

    def watch(self, node: Node, mode: str) -> Callable[[], bool]:
        """Follow the flight's time with a node; a switch is one call of a parameter service."""
        client = AsyncParameterClient(node, "nmpc")
        left = [(k * SECONDS_A_MODE, each) for k, each in enumerate(MODES) if each != mode]

        def on_clock(message: Clock) -> None:
            if left and stamps.seconds(stamps.decode(message.clock)) >= left[0][0]:
                client.set_parameters([Parameter("mode", value=left.pop(0)[1])])

        topics.CLOCK.subscription(node, on_clock)
        return lambda: False


def record(folder: Path) -> Path:
    """Fly in all modes, in a folder that is there; return the bag in it."""
    bag, domain_id = folder / SAMPLE.name, 1 + os.getpid() % 100
    # Compiled before anybody waits.
    Controller()
    with nodes(domain_id, folder) as start:
        start("gtmr_monitor.node", {"bag": str(bag)})
        start("gtmr_nmpc.node", {"mode": MODES[0], "recorders": "1"})
        sim = start(
            "gtmr_sim.node",
            {
                "zeta": str(list(ZETA)),
                "seed": "7",
                "duration_s": str(SECONDS_A_MODE * len(MODES)),
                "recorders": "1",
            },
        )
        watch(domain_id, MODES[0], sim, lambda *_: None, Switches())
    return bag


def faults(bag: Path) -> list[str]:
    """Say what is wrong with a bag that shall be an example; nothing if it is one."""
    flight, period_s = read_flight(bag), ControllerConfig().sampling_time_s
    found = []
    if flight.deadline_misses:
        found.append(f"{flight.deadline_misses} steps took longer than T_s")
    for topic in (topics.ODOM, topics.ROTOR_COMMAND):
        messages = [m for m in read_messages(bag) if m.topic == f"/{topic.name}"]
        stamped = np.array([stamps.decode(m.decode().header.stamp) for m in messages])
        gap_s = 1e-9 * np.diff(np.unique(stamped)).max()
        if gap_s > 1.5 * period_s:
            found.append(f"/{topic.name}: a gap of {gap_s:.3f} s")
        sent_s = 1e-9 * np.array([m.publish_time_ns for m in messages])
        # Against the flight's own time, from when it began.
        flying = stamped > stamped[0]
        late_s = np.diff(sent_s[flying]).max()
        if late_s > 1.5 * period_s:
            found.append(f"/{topic.name}: sent {late_s:.3f} s after the one before")
    for message in read_messages(bag):
        if message.topic == topics.DIAGNOSTICS.name:
            for status in message.decode().status:
                told = {pair.key: pair.value for pair in status.values}
                bad = {k: told[k] for k in COUNTERS if told.get(k, "0") not in ("0", "false")}
                if bad:
                    found.append(f"{status.name}: {bad}")
    size = sum(file.stat().st_size for file in bag.iterdir())
    if size > MOST_BYTES:
        found.append(f"{size} bytes, more than {MOST_BYTES}")
    return found


COUNTERS = (
    "deadline_misses",
    "skipped_steps",
    "withheld_commands",
    "missed_commands",
    "guard",
    "failed_in_window",
    "odometry_gaps",
    "messages_not_heard",
    "messages_not_written",
    "callback_errors",
)
"""Diagnostics that must be zero."""


def main() -> int:
    """Record, check, and put the bag in its place."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bag = record(Path(folder))
        found = faults(bag)
        if found:
            print("\n".join(["not taken:", *found]), file=sys.stderr)
            return 1
        shutil.rmtree(SAMPLE, ignore_errors=True)
        shutil.copytree(bag, SAMPLE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
