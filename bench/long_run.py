# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Fly for long, and see that memory, open files and threads stay flat and no step is missed.

Run with ``python bench/long_run.py --hours 24`` for simulated hours in this process, as fast as
they go; ``--minutes 15`` stops after so many minutes of wall time and says how far it came. For
real time between nodes there is ``bench/node_latency.py``.
"""

import argparse
import json
import os
import threading
import time
from pathlib import Path

from gtmr_nmpc import Controller
from gtmr_sim import Scenario, Simulation
from gtmr_study.solvers.bench import machine

LOOKS = 10
"""How often memory, files and threads are looked at."""


def resources() -> dict[str, float]:
    """Resident memory [MiB], open files and threads of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return {
        "mib": pages * os.sysconf("SC_PAGE_SIZE") / 2**20,
        "files": len(list(Path("/proc/self/fd").iterdir())),
        "threads": threading.active_count(),
    }


def main() -> None:
    """Fly, and print a JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated [h]")
    parser.add_argument("--minutes", type=float, default=600.0, help="wall time at most [min]")
    given = parser.parse_args()
    controller = Controller()
    period_s = controller.config.sampling_time_s
    simulation = Simulation(Scenario(seed=1).sampled(), period_s)
    steps = round(3600.0 * given.hours / period_s)
    least_m, failed, done, looks = float("inf"), 0, 0, []
    start = time.monotonic()
    for k in range(steps):
        t = simulation.time_s
        solution = controller.step(t, simulation.x)
        failed += solution.status == "failed"
        simulation.command(t, solution.u_plan)
        simulation.advance(period_s)
        least_m = min(least_m, float(simulation.scenario.tower.clearance(simulation.x[:3])))
        done = k + 1
        if k % 4000 == 0 and 60.0 * given.minutes < time.monotonic() - start:
            break
        if done % max(1, steps // (10 * LOOKS)) == 0:
            looks.append({"simulated_h": t / 3600.0, **resources()})
    result = {
        "machine": machine(),
        "simulated_h": done * period_s / 3600.0,
        "wall_min": (time.monotonic() - start) / 60.0,
        "steps": done,
        "failed_steps": failed,
        "guard_s": simulation.guard_time_s,
        "least_clearance_m": least_m,
        "looks": looks[:: max(1, len(looks) // LOOKS)],
    }
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
