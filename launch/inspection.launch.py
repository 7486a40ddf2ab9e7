# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Simulator, controller and monitor together: `ros2 launch gtmr inspection.launch.py`."""

from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction

from gtmr_msgs_py.start import launching
from gtmr_msgs_py.start.launching import IN_FLIGHT_TIME

ARGUMENTS = {
    "mode": launching.MODE,
    "bag": launching.BAG,
    "lockstep": launching.LOCKSTEP,
    **launching.COMMON,
}
"""The launch arguments, by name."""


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*launching.declare(ARGUMENTS), OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Any]:
    """Start what was asked for; a flight that is recorded waits for the recorder."""
    given = launching.values(ARGUMENTS, context.launch_configurations)
    bag = given.get("bag", "")
    recorders = {"recorders": 1 if bag else 0}
    return [
        *launching.node("sim", ARGUMENTS, given, recorders),
        *launching.node("nmpc", ARGUMENTS, given, recorders | IN_FLIGHT_TIME),
        *launching.node("monitor", ARGUMENTS, given, {"bag": bag} | IN_FLIGHT_TIME),
        *launching.views(given),
    ]
