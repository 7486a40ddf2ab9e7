# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A recorded flight for controller and monitor: `ros2 launch gtmr replay.launch.py bag:=...`.

The controller answers the recorded odometry; what it commands moves nothing.
"""

from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction

from gtmr_msgs_py.start import launching
from gtmr_msgs_py.start.launching import IN_FLIGHT_TIME, Argument

START_TIMEOUT_S = 60
"""How long the playback waits for the nodes to listen [s]."""
ARGUMENTS = {
    "bag": Argument("Bag to play"),
    "rate": Argument("How many times as fast as it was recorded", "1.0", kind=float),
    "loop": Argument("Whether to begin again at the end", "false", kind=bool),
    "record": Argument("New folder to record into; empty for no recording"),
    "mode": launching.MODE,
    "vehicle": Argument("Name of a preset, or path of a .yaml file", parameter_of=("nmpc",)),
    **launching.EVERYWHERE,
}
"""The launch arguments, by name."""


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*launching.declare(ARGUMENTS), OpaqueFunction(function=processes)])


def processes(context: LaunchContext) -> list[Any]:
    """Start the nodes, and the playback that ends them when it is over."""
    given = launching.values(ARGUMENTS, context.launch_configurations)
    if "bag" not in given:
        raise ValueError("bag:= is missing: give the bag to play")
    record = {"bag": given.get("record", "")}
    play = ["play", given["bag"], "--rate", str(given["rate"]), "--wait", str(START_TIMEOUT_S)]
    play += ["--loop"] if given["loop"] else []
    return [
        *launching.node("nmpc", ARGUMENTS, given, IN_FLIGHT_TIME),
        *launching.node("monitor", ARGUMENTS, given, record | IN_FLIGHT_TIME),
        launching.python("gtmr_study.cli", *play),
        *launching.views(given),
    ]
