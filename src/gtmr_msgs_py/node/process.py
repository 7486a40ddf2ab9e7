# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A node as a process: start, spin, end without a traceback."""

import gc
import signal
import sys
from argparse import ArgumentParser
from collections.abc import Callable

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from gtmr_model import ConfigError
from gtmr_msgs_py.node.given_names import refuse_unknown_names
from gtmr_msgs_py.node.suite_node import SuiteNode
from gtmr_msgs_py.start.parent import end_with_parent

try:
    from rclpy.experimental import EventsExecutor as Prompt
except ModuleNotFoundError:
    # The first releases of Jazzy have none.
    Prompt = SingleThreadedExecutor

BAD_INPUT = 2
"""Exit code when a parameter or an argument cannot be used."""
PROMPT: Callable[..., Executor] = Prompt
"""Hands a message on in half the time of rclpy's usual executor, which at every message waits for
everything anew; of rclpy 7.1.6 it has no callbacks that ask what the middleware tells of it."""
WAIT_S = 0.1
"""How long to wait for anything to happen before looking whether to go on [s]; without any such
limit `PROMPT` of rclpy 7.1.6 handles nothing."""
STOPS = (signal.SIGINT, signal.SIGTERM)
"""Signals that end a node."""
MANAGED = "--managed"
"""Argument that makes a node wait for its lifecycle services to configure and activate it."""


def run(
    make_node: Callable[[bool], SuiteNode],
    args: list[str] | None = None,
    make_executor: Callable[[], Executor] = SingleThreadedExecutor,
) -> int:
    """Run one node until it is told to stop, and return the exit code.

    It is 0 after SIGINT, SIGTERM or the node's own end, 2 for bad input: a ConfigError is reported
    in one line. ``make_node`` is told whether the node is managed by its lifecycle services, as
    ``--managed`` among the arguments says, ``sys.argv`` if none are given; what calls it back in
    the control loop is `PROMPT`. Raises SystemExit with ``--help``, and for an argument that does
    not exist.
    """
    end_with_parent()
    command_line = sys.argv[1:] if args is None else args
    managed = _is_managed(make_node, command_line)
    try:
        # rclpy's own handlers close the context under a callback, and interrupt it.
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        sys.stderr.write(f"error: {_reason(error)}\n")
        return BAD_INPUT
    node = None
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        try:
            node = make_node(managed)
        except RCLError as error:
            # No participant, for example if the requested security is not available.
            raise ConfigError(_reason(error)) from None
        refuse_unknown_names(node, command_line)
        if not managed:
            node.start()
        # Objects from the start live as long as the process: no collection need visit them.
        gc.collect()
        gc.freeze()
        _spin(node, make_executor())
    except KeyboardInterrupt:
        pass
    except ConfigError as error:
        sys.stderr.write(f"error: {error}\n")
        return BAD_INPUT
    except Exception as error:
        # During a conversion in C, a KeyboardInterrupt causes another error.
        if not isinstance(error.__cause__, KeyboardInterrupt):
            raise
    finally:
        # A second Ctrl-C must not tear the teardown apart.
        for stop in STOPS:
            signal.signal(stop, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _reason(error: Exception) -> str:
    """Say in one line what rcl said in several, without its own places in the source."""
    return " ".join(str(error).partition(", at /")[0].split())


def _is_managed(make_node: Callable[[bool], SuiteNode], args: list[str]) -> bool:
    """Read what is no ROS argument; neither is a remap without ``--ros-args``, which rcl takes.

    ``mode:=robust`` is meant for `ros2 launch`, and would rename a topic here.
    """
    own, ros = [], False
    for argument in args:
        if argument == "--ros-args" or (ros and argument == "--"):
            ros = argument == "--ros-args"
        elif not ros:
            own.append(argument)
    parser = ArgumentParser(
        allow_abbrev=False,
        description=(make_node.__doc__ or "").partition("\n")[0],
        usage="%(prog)s [-h] [--managed] [--ros-args [-p NAME:=VALUE] [--params-file FILE] ...]",
        epilog="`ros2 param list` names the parameters; config/parameters.yaml has every default.",
    )
    parser.add_argument(MANAGED, action="store_true", help="wait for lifecycle services to start")
    return bool(parser.parse_args(own).managed)


def _spin(node: SuiteNode, executor: Executor) -> None:
    """Call a node back until it is over, or a signal comes; the callback in hand is finished."""

    def stop(*_: object) -> None:
        node.over = True

    for name in STOPS:
        signal.signal(name, stop)
    executor.add_node(node)
    while not node.over:
        executor.spin_once(WAIT_S)
