# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The same flight twice, nominal and robust side by side: `ros2 launch gtmr compare.launch.py`.

Every mode flies in a namespace of its own name; both go into one bag.
"""

from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction
from launch.events.process import ProcessExited

from gtmr_msgs_py.start import launching
from gtmr_msgs_py.start.launching import IN_FLIGHT_TIME

MODES = ("nominal", "robust")
"""Modes, and namespaces."""
ARGUMENTS = {"bag": launching.BAG, **launching.COMMON}
"""The launch arguments, by name."""


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*launching.declare(ARGUMENTS), OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Any]:
    """Start two flights in lockstep, as only then both meet the same gusts, and one monitor."""
    given = launching.values(ARGUMENTS, context.launch_configurations)
    bag = given.get("bag", "")
    recorders = {"recorders": 1 if bag else 0}
    flying = len(MODES)

    def landed(event: ProcessExited, context: LaunchContext) -> list[Any]:
        """Let the other fly on after the first that is done."""
        nonlocal flying
        flying -= 1
        return [] if flying and event.returncode == 0 else launching.required(event, context)

    started = []
    for mode in MODES:
        lockstep, in_mode = {"lockstep": True}, {"mode": mode}
        started += [
            *launching.node("sim", ARGUMENTS, given, recorders | lockstep, mode, on_exit=landed),
            *launching.node("nmpc", ARGUMENTS, given, recorders | in_mode | IN_FLIGHT_TIME, mode),
        ]
    watched = {"bag": bag, "namespaces": list(MODES)}
    monitor = launching.node("monitor", ARGUMENTS, given, watched)
    return [*started, *monitor, *launching.views(given, MODES)]
