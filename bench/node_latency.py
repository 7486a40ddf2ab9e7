# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Time from an odometry message to the command computed from it, over ROS 2, in real time.

Run with ``python bench/node_latency.py --minutes 10``: the simulator in this process, the
controller in another; ``--rate 200 --horizon 40`` for a controller five times as fast. Memory is
that of both processes, resident, at the end of the first minute and of the last.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

from gtmr_msgs_py import topics
from gtmr_msgs_py.messages.rotor_command import RotorPlan
from gtmr_msgs_py.node.process import PROMPT, run
from gtmr_msgs_py.start.environment import ros_environment
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim.node import SimNode
from gtmr_study.solvers.bench import machine

WARM_UP_S = 5.0
"""Time at the start that is not counted [s]."""
MEMORY_PERIOD_S = 10.0
"""Between two looks at the memory [s]."""
COUNTERS = (
    "controller deadline_misses",
    "controller skipped_steps",
    "controller latency_median_ms",
    "controller latency_p99_ms",
    "controller failed_in_window",
    "simulator missed_commands",
    "simulator real_time_factor",
)
"""What is told of the nodes' diagnostics."""


class TimedSimNode(SimNode):
    """The simulator, noting when it published a state and when the command from it came."""

    controller_pid = 0

    def __init__(self, managed: bool = False) -> None:
        self.started_at = time.monotonic()
        self.latencies_s: list[float] = []
        self.memory_mib: list[tuple[float, float]] = []
        self.said: dict[str, str] = {}
        self._published: dict[int, float] = {}
        super().__init__(managed)

    def connect(self) -> None:
        """Listen to the controller's diagnostics too, and watch the memory."""
        super().connect()
        topics.DIAGNOSTICS.subscription(self, self._on_diagnostics)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(MEMORY_PERIOD_S, self._watch_memory, clock=steady)
        self._watch_memory()

    def _publish_state(self, measured: bool) -> None:
        if measured:
            self._published[self._session.measured_ns] = time.monotonic()
        super()._publish_state(measured)

    def _play(self, plan: RotorPlan) -> None:
        published = self._published.get(plan.stamp_ns)
        if published is not None and published - self.started_at > WARM_UP_S:
            self.latencies_s.append(time.monotonic() - published)
        super()._play(plan)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            source = status.name.split(": ")[-1]
            self.said |= {f"{source} {pair.key}": pair.value for pair in status.values}

    def _watch_memory(self) -> None:
        newest = max(self._published, default=0)
        self._published = {newest: self._published.get(newest, 0.0)}
        self.memory_mib.append((resident_mib("self"), resident_mib(self.controller_pid)))


def resident_mib(pid: int | str) -> float:
    """Resident memory of a process [MiB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="utf-8").split()[1])
    return pages * resource.getpagesize() / 2**20


def main() -> None:
    """Fly, and print a JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--rate", type=int, default=40, help="steps of the controller [Hz]")
    parser.add_argument("--horizon", type=int, default=20, help="stages N")
    given = parser.parse_args()
    for name, least in (("minutes", 0.01), ("rate", 1), ("horizon", 2)):
        if not getattr(given, name) >= least:
            parser.error(f"--{name} {getattr(given, name)}: allowed is {least} or more")
    os.environ.update(ros_environment())
    sampling_time_s = 1.0 / given.rate
    # Compiled before anybody waits.
    Controller(ControllerConfig(horizon=given.horizon, sampling_time_s=sampling_time_s))

    common = ["--ros-args", "-p", f"sampling_time_s:={sampling_time_s}"]
    controller = subprocess.Popen(
        [sys.executable, "-m", "gtmr_nmpc.node", *common, "-p", f"horizon:={given.horizon}"]
    )
    TimedSimNode.controller_pid = controller.pid
    made: list[TimedSimNode] = []

    def make(managed: bool) -> TimedSimNode:
        made.append(TimedSimNode(managed))
        return made[0]

    try:
        duration_s = WARM_UP_S + 60.0 * given.minutes
        run(make, [*common, "-p", f"duration_s:={duration_s}"], PROMPT)
    finally:
        controller.send_signal(signal.SIGINT)
        controller.wait()
    node = made[0]
    values_ms = 1e3 * np.array(node.latencies_s)
    median, p99, p999, worst = np.percentile(values_ms, (50.0, 99.0, 99.9, 100.0))
    early, late = node.memory_mib[min(6, len(node.memory_mib) - 1)], node.memory_mib[-1]
    result = {
        "machine": machine(),
        "rate_hz": given.rate,
        "horizon": given.horizon,
        "commands": len(values_ms),
        "latency_ms": {"median": median, "p99": p99, "p99.9": p999, "max": worst},
        "simulator_mib": [early[0], late[0]],
        "controller_mib": [early[1], late[1]],
        **{key: value for key, value in sorted(node.said.items()) if key in COUNTERS},
    }
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
