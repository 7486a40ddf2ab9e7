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

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction, Shutdown
from launch_ros.actions import Node

from gtmr_msgs_py.start import launching

MODES = ("nominal", "robust")
"""Modes, and namespaces."""
ARGUMENTS = {"bag": launching.BAG, **launching.COMMON}
"""The launch arguments, by name."""
OWN_CLOCK = [("/clock", "clock")]
"""Two simulators make two times: each is heard in its own namespace only."""


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*launching.declare(ARGUMENTS), OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Node]:
    """Start two flights in lockstep, as only then both meet the same gusts, and one monitor."""
    given = launching.values(ARGUMENTS, context.launch_configurations)
    bag = given.get("bag", "")
    recorders = {"recorders": 1 if bag else 0}
    flying = set(MODES)

    def end_after_the_last(mode: str) -> OpaqueFunction:
        def ended(_: LaunchContext) -> list[Shutdown]:
            flying.discard(mode)
            return [] if flying else [Shutdown()]

        return OpaqueFunction(function=ended)

    started = []
    for mode in MODES:
        where = {"namespace": mode, "remappings": OWN_CLOCK}
        started += [
            launching.node(
                "sim",
                ARGUMENTS,
                given,
                recorders | {"lockstep": True},
                on_exit=end_after_the_last(mode),
                **where,
            ),
            launching.node(
                "nmpc", ARGUMENTS, given, recorders | {"mode": mode, "use_sim_time": True}, **where
            ),
        ]
    monitor = launching.node("monitor", ARGUMENTS, given, {"bag": bag, "namespaces": list(MODES)})
    return [*started, monitor, *launching.views(given)]
