# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""Simulator, controller and monitor together: `ros2 launch gtmr inspection.launch.py`."""

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction, Shutdown
from launch_ros.actions import Node

from gtmr_msgs_py import launching

ARGUMENTS = {
    "mode": launching.MODE,
    "bag": launching.BAG,
    "lockstep": launching.LOCKSTEP,
    **launching.COMMON,
}
"""The launch arguments, by name."""


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*launching.declare(ARGUMENTS), OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Node]:
    """Start what was asked for; a flight that is recorded waits for the recorder."""
    given = launching.values(ARGUMENTS, context.launch_configurations)
    bag = given.get("bag", "")
    recorders = {"recorders": 1 if bag else 0}
    in_flight_time = {"use_sim_time": True}
    return [
        launching.node("sim", ARGUMENTS, given, recorders, on_exit=Shutdown()),
        launching.node("nmpc", ARGUMENTS, given, recorders | in_flight_time),
        launching.node("monitor", ARGUMENTS, given, {"bag": bag} | in_flight_time),
        *launching.views(given),
    ]
