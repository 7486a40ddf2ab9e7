# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The demo: simulator, controller and monitor as processes of a real ROS graph, once a mode."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import rclpy
import yaml
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Range

from gtmr_model import YamlModel
from gtmr_model.yaml_model import presets_of
from gtmr_msgs_py import topics
from gtmr_msgs_py.start.environment import ros_environment
from gtmr_msgs_py.wire import stamps
from gtmr_nmpc import ControllerConfig
from gtmr_sim import Scenario

if TYPE_CHECKING:
    from rclpy.node import Node

STOP_TIMEOUT_S = 20.0
"""How long a node may take to end after SIGINT [s]."""
STALL_TIMEOUT_S = 30.0
"""How long simulated time may stand still before the demo gives up [s]."""

OnProgress = Callable[[float, float], None]
"""Told the simulated time [s] and the clearance [m] while flying."""


class Onlooker(Protocol):
    """Who takes part in a flight, beside the nodes that fly it."""

    def watch(self, node: Node, mode: str) -> Callable[[], bool]:
        """Use a node that hears the flight, begun in a mode.

        What is returned is called often, and says whether time is meant to stand still.
        """


class DemoError(RuntimeError):
    """A node failed, or the flight does not go on; the message says where its log is."""


@dataclass(frozen=True)
class InRos:
    """What is flown, by nodes that take it from their parameters."""

    mode: str
    """Of the controller."""
    controller: str
    """A preset's name, or the path of a YAML file: what the controller node reads."""
    world: str
    """Likewise what the simulator meets."""
    config: ControllerConfig
    """The controller, perhaps of another vehicle than its file says."""
    scenario: Scenario
    """The plant's side; what of it is not the paper's is told to the simulator."""


def fly_in_ros(
    flown: InRos,
    duration_s: float,
    folder: Path,
    on_progress: OnProgress,
    onlooker: Onlooker | None = None,
) -> Path:
    """Fly the helix once, in real time where the machine keeps up, with one process a node.

    The folder is new or empty, and receives the bag and a log of each node, and the vehicle where
    it is no preset; ``on_progress`` is called while flying.

    Raises DemoError if a node ends with an error, or simulated time stands still.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # Another graph on this machine must not hear this one, nor the other way round.
    domain_id = 1 + os.getpid() % 100
    bag = folder / "bag"
    scenario, vehicle = flown.scenario, _vehicle(flown.scenario, folder)
    tower = _parameters("tower", scenario.tower)
    with nodes(domain_id, folder) as start:
        start("gtmr_monitor.node", {"bag": str(bag), **tower})
        nmpc = {"mode": flown.mode, "controller": flown.controller, "vehicle": vehicle}
        start("gtmr_nmpc.node", {**nmpc, "recorders": "1"})
        sim = start(
            "gtmr_sim.node",
            {
                "vehicle": vehicle,
                "world": flown.world,
                "zeta": _text(scenario.zeta),
                "seed": str(scenario.seed),
                "gust.kind": scenario.gust.kind,
                "gust.sequence": _text(scenario.gust.sequence),
                "sampling_time_s": _text(flown.config.sampling_time_s),
                **tower,
                **_parameters("helix", scenario.helix),
                **_parameters("uncertainty", scenario.uncertainty),
                "duration_s": _text(float(duration_s)),
                "recorders": "1",
                # In lockstep the flight is the same on a busy machine, only slower.
                "lockstep": "true",
            },
        )
        watch(domain_id, flown.mode, sim, on_progress, onlooker)
    return bag


def _vehicle(scenario: Scenario, folder: Path) -> str:
    """Name a preset or a file of the vehicle, written if need be: nodes take no other."""
    vehicle = scenario.vehicle
    for name in presets_of("vehicle"):
        if type(vehicle).preset("vehicle", name) == vehicle:
            return name
    path = folder.absolute() / "vehicle.yaml"
    path.write_text(yaml.safe_dump(vehicle.model_dump(mode="json"), sort_keys=False))
    return str(path)


def _parameters(name: str, model: YamlModel) -> dict[str, str]:
    """Make parameters of a model of numbers, tuples of them, and texts."""
    return {f"{name}.{field}": _text(value) for field, value in model.model_dump().items()}


def _text(value: object) -> str:
    """Write a value as the command line of a node takes it."""
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(_text(each) for each in value)}]"
    return repr(value) if isinstance(value, float) else str(value)


@dataclass
class NodeProcess:
    """A node of the suite as a process of its own, and its log."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def require_well(self) -> None:
        """Raise DemoError if it ended with an error."""
        code = self.process.poll()
        if code not in (None, 0):
            last = self.log.read_text(errors="replace").strip().rpartition("\n")[2]
            raise DemoError(f"{self.name} ended with exit code {code}: {last} (see {self.log})")

    def stop(self) -> None:
        """End it as Ctrl-C does, or outright if it takes too long."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()


@contextmanager
def nodes(domain_id: int, folder: Path) -> Iterator[Callable[..., list[NodeProcess]]]:
    """Start nodes one after the other, and end them all, the recorder last."""
    started: list[NodeProcess] = []
    environment = ros_environment(domain_id)

    def start(module: str, parameters: Mapping[str, str]) -> list[NodeProcess]:
        name = module.partition(".")[0]
        log = folder / f"{name}.log"
        assigned = [f"{key}:={value}" for key, value in parameters.items()]
        arguments = [part for each in assigned for part in ("-p", each)]
        with log.open("wb") as output:
            # A session of its own keeps the terminal's Ctrl-C for the demo, which ends the
            # nodes in an order that leaves the bag whole.
            process = subprocess.Popen(
                [sys.executable, "-m", module, "--ros-args", *arguments],
                env=environment,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        started.append(NodeProcess(name, process, log))
        return started

    try:
        yield start
    finally:
        for node in reversed(started):
            node.stop()
    for node in started:
        node.require_well()


def watch(
    domain_id: int,
    mode: str,
    nodes: list[NodeProcess],
    on_progress: OnProgress,
    onlooker: Onlooker | None = None,
) -> None:
    """Watch a flight until the simulator, the node started last, ends."""
    # The profile is read when the first participant of a process is made.
    os.environ.update(ros_environment(domain_id))
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    node = rclpy.create_node("demo", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    time_s, changed_at = 0.0, time.monotonic()

    def on_clock(message: Clock) -> None:
        nonlocal time_s, changed_at
        now_s = stamps.seconds(stamps.decode(message.clock))
        if now_s > time_s:
            time_s, changed_at = now_s, time.monotonic()

    def on_clearance(message: Range) -> None:
        on_progress(time_s, message.range)

    try:
        topics.CLOCK.subscription(node, on_clock)
        topics.CLEARANCE.subscription(node, on_clearance)
        refresh = None if onlooker is None else onlooker.watch(node, mode)
        while nodes[-1].process.poll() is None:
            executor.spin_once(timeout_sec=0.05)
            if refresh is not None and refresh():
                changed_at = time.monotonic()
            for each in nodes:
                each.require_well()
            if time.monotonic() - changed_at > STALL_TIMEOUT_S:
                raise DemoError(
                    f"simulated time stands still at {time_s:g} s (see {nodes[-1].log})"
                )
        nodes[-1].require_well()
    finally:
        node.destroy_node()
        executor.shutdown()
        rclpy.shutdown(context=context)
