# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Every fault that needs no ROS."""

from gtmr_study.faults import files
from gtmr_study.faults.fault import Fault, OneByOne
from gtmr_study.faults.links import COMMANDS, MEASUREMENTS
from gtmr_study.faults.onboard import CONTROLLER
from gtmr_study.faults.vehicle import VEHICLE

LOOP_TRIES, LOOP_QUICK = 230, 4
"""How often each fault of the closed loop is tried, and how often in the quick campaign."""
NOT_ALWAYS = ("odometry-frozen", "rotor-at-50", "rotor-at-0", "rotor-stuck", "start-spinning")
"""Faults of the loop under which nothing is promised; it is counted what happens."""


def faults() -> dict[str, Fault]:
    """Give them by name, in the order of the table."""
    loop = [
        Fault(
            name,
            promise,
            "loop",
            LOOP_TRIES,
            LOOP_QUICK,
            OneByOne(disturbance),
            name not in NOT_ALWAYS,
        )
        for group in (COMMANDS, CONTROLLER, MEASUREMENTS, VEHICLE)
        for name, (promise, disturbance) in group.items()
    ]
    return {fault.name: fault for fault in (*loop, *files.faults())}
