# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the launch files have in common; needs ``launch`` and ``launch_ros``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
)
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    LogInfo,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessStart
from launch_ros.actions import Node

from gtmr_model.yaml_file import parse_yaml
from gtmr_msgs_py.start.environment import node_environment

if TYPE_CHECKING:
    from launch.events.process import ProcessExited
    from launch.launch_context import LaunchContext

IN_FLIGHT_TIME = {"use_sim_time": True}
"""Parameters of a node that goes by the simulator's clock."""
BAD_INPUT = 2
"""Exit code of a node that cannot use a parameter, which another try would not change."""
RESPAWNED = ("nmpc", "monitor")
"""Executables that are started again if they fail."""
RESPAWN_DELAY_S = 0.1
"""Time before that [s]: launch has to learn of its own end first."""
VIEWERS = {"rviz": "rviz2", "foxglove": "foxglove_bridge"}
"""Package, and executable, by argument."""

OnExit = Callable[["ProcessExited", "LaunchContext"], "list[Any]"]
"""What follows when a process has ended."""


@dataclass(frozen=True)
class Argument:
    """A launch argument."""

    description: str
    """What ``ros2 launch --show-args`` says."""
    default: str = ""
    """Value if it is not given; empty leaves a parameter to the parameter file."""
    parameter_of: tuple[str, ...] = ()
    """Executables that have a parameter of the same name, which it sets."""
    kind: type = str
    """Type of that parameter."""
    choices: tuple[str, ...] = ()
    """What it may be, if not anything."""


MODE = Argument(
    "Controller mode; may change in flight; empty for that of the parameter file",
    parameter_of=("nmpc",),
    choices=("", "nominal", "robust", "offset_free"),
)
BAG = Argument("New folder to record the flight into; empty for no recording")
LOCKSTEP = Argument(
    "Whether to wait for the command of every odometry: the same flight every time",
    parameter_of=("sim",),
    kind=bool,
)
EVERYWHERE = {
    "params_file": Argument(
        "Parameters of all nodes: paper, wind, worst-case, or the path of a .yaml file", "paper"
    ),
    "namespace": Argument(
        "Namespace of all nodes, with a clock of its own; empty for none and /clock"
    ),
    "log_level": Argument(
        "What the nodes tell", "info", choices=("debug", "info", "warn", "error", "fatal")
    ),
    "respawn": Argument(
        "How many times a controller or monitor that failed is started again", "3", kind=int
    ),
    "managed": Argument(
        "Whether nodes have lifecycle services; they are configured and activated too",
        "false",
        kind=bool,
    ),
    "rviz": Argument("Whether to open RViz", "false", kind=bool),
    "foxglove": Argument("Whether to start foxglove_bridge", "false", kind=bool),
    "address": Argument("Where foxglove_bridge listens; 0.0.0.0 is everywhere", "127.0.0.1"),
}
"""Arguments of every launch file."""
COMMON = {
    **EVERYWHERE,
    "vehicle": Argument("Name of a preset, or path of a .yaml file", parameter_of=("sim", "nmpc")),
    "world": Argument(
        "What the vehicle meets: name of a preset, or path of a .yaml file", parameter_of=("sim",)
    ),
    "controller": Argument(
        "Name of a preset, or path of a .yaml file, as that of its world",
        parameter_of=("nmpc",),
    ),
    "zeta": Argument("True mismatch and wind bias, 9 numbers", parameter_of=("sim",), kind=list),
    "sample_zeta": Argument(
        "Whether to draw them from the uncertainty set", parameter_of=("sim",), kind=bool
    ),
    "seed": Argument("Seed of the gusts, and of a drawn zeta", parameter_of=("sim",), kind=int),
    "real_time_factor": Argument(
        "Simulated per wall time; 0 is as fast as possible, in lockstep",
        parameter_of=("sim",),
        kind=float,
    ),
    "duration_s": Argument(
        "When the flight is over and everything ends [s]; 0 is never",
        parameter_of=("sim",),
        kind=float,
    ),
}
"""Arguments of every launch file that flies."""


def declare(arguments: Mapping[str, Argument]) -> list[DeclareLaunchArgument]:
    """Declare launch arguments by name."""
    return [
        DeclareLaunchArgument(
            name,
            default_value=a.default,
            description=a.description,
            choices=list(a.choices) or None,
        )
        for name, a in arguments.items()
    ]


def values(arguments: Mapping[str, Argument], given: Mapping[str, str]) -> dict[str, Any]:
    """Read the arguments that were given, as what they are, before anything is started.

    ``given`` is text by name, as ``context.launch_configurations`` has it; empty is not given.
    Raises ValueError if a text is not of the argument's kind, or a viewer is not installed.
    """
    read = {name: _value(name, a, given[name]) for name, a in arguments.items() if given[name]}
    for name, package in VIEWERS.items():
        if read[name] and not _is_installed(package):
            raise ValueError(f"{name}:=true needs the package {package}, which is not installed")
    return read


def _value(name: str, argument: Argument, text: str) -> Any:
    if argument.kind is str:
        return text
    value = parse_yaml(text, f"{name}:={text}")
    # Whole numbers do for floats, in lists too.
    if argument.kind is float and type(value) is int:
        return float(value)
    if type(value) is list and argument.kind is list:
        return [float(item) for item in value]
    if type(value) is not argument.kind:
        raise ValueError(f"{name}:={text}: expected {argument.kind.__name__}")
    return value


def _is_installed(package: str) -> bool:
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


def required(event: ProcessExited, context: LaunchContext) -> list[Any]:
    """End the launch when a process has ended by itself, and as a failure if that failed.

    Raises RuntimeError if its exit code is not 0; `ros2 launch` then ends all others, and with
    exit code 1.
    """
    if context.is_shutdown:
        return []
    if event.returncode != 0:
        raise RuntimeError(f"{event.process_name} ended with exit code {event.returncode}")
    return [Shutdown(reason=f"{event.process_name} has ended")]


def _required_after(tries: int) -> OnExit:
    """Let a process that failed be started again so many times, then end the launch as a failure.

    What it cannot use is not tried again.
    """
    left = tries

    def failed(event: ProcessExited, context: LaunchContext) -> list[Any]:
        nonlocal left
        if context.is_shutdown or event.returncode in (0, BAD_INPUT) or left == 0:
            return required(event, context)
        left -= 1
        again = f"{event.process_name} ended with exit code {event.returncode}: starts again"
        return [LogInfo(msg=f"{again}, {left} more times at most")]

    return failed


def node(
    executable: str,
    arguments: Mapping[str, Argument],
    given: Mapping[str, Any],
    parameters: Mapping[str, Any],
    below: str = "",
    on_exit: OnExit = required,
) -> list[Any]:
    """Start ``sim``, ``nmpc`` or ``monitor`` with the values of a launch file's arguments.

    Further parameters win over those; ``below`` is a namespace below the one that was given.
    Controller and monitor are started again if they fail, the simulator is not: it has no flight
    to go on with. A managed node is brought up whenever it has started.
    """
    respawns = given["respawn"] if executable in RESPAWNED else 0
    managed = given["managed"]
    set_by_argument = {n: v for n, v in given.items() if executable in arguments[n].parameter_of}
    made = Node(
        package="gtmr",
        executable=executable,
        arguments=["--managed"] if managed else [],
        parameters=[parameter_file(given["params_file"]), {**set_by_argument, **parameters}],
        ros_arguments=["--log-level", given["log_level"]],
        additional_env=node_environment(),
        output="screen",
        on_exit=_required_after(respawns) if respawns else on_exit,
        respawn=respawns > 0,
        respawn_max_retries=respawns,
        respawn_delay=RESPAWN_DELAY_S,
        **_place(given, below),
    )
    if not managed:
        return [made]
    name = "/".join(("", *_namespace(given, below), executable))

    def bring_up(*_: Any) -> list[Any]:
        return [python("gtmr_msgs_py.start.bring_up", name, on_exit=_brought_up)]

    return [RegisterEventHandler(OnProcessStart(target_action=made, on_start=bring_up)), made]


def _brought_up(event: ProcessExited, context: LaunchContext) -> list[Any]:
    return [] if event.returncode == 0 else required(event, context)


def python(module: str, *arguments: str, on_exit: OnExit = required) -> ExecuteProcess:
    """Run a module of the suite as a process of its own.

    As scripts/ find Python: `gtmr` itself is on no path under colcon.
    """
    return ExecuteProcess(
        name=module.rpartition(".")[2],
        cmd=["python3", "-m", module, *arguments],
        additional_env=node_environment(),
        output="screen",
        on_exit=on_exit,
    )


def views(given: Mapping[str, Any], below: tuple[str, ...] = ("",)) -> list[Node]:
    """Start the viewers that were asked for, RViz once for each namespace; both may be closed."""
    config = ["-d", str(share() / "rviz" / "inspection.rviz")]
    listening: dict[str, dict[str, Any]] = {"foxglove": {"address": given["address"]}}
    places: dict[str, list[dict[str, Any]]] = {
        "rviz": [_place(given, each) for each in below],
        "foxglove": [{}],
    }
    return [
        Node(
            package=package,
            executable=package,
            arguments=config if name == "rviz" else [],
            parameters=[IN_FLIGHT_TIME | listening.get(name, {})],
            **place,
        )
        for name, package in VIEWERS.items()
        if given[name]
        for place in places[name]
    ]


def _place(given: Mapping[str, Any], below: str) -> dict[str, Any]:
    """Say where a node is; in a namespace it has time and transforms of its own."""
    namespace = "/".join(_namespace(given, below))
    if not namespace:
        return {}
    own = [(f"/{name}", name) for name in ("clock", "tf", "tf_static")]
    return {"namespace": namespace, "remappings": own}


def _namespace(given: Mapping[str, Any], below: str) -> list[str]:
    return [part for part in (given.get("namespace", "").strip("/"), below) if part]


def parameter_file(name_or_path: str) -> str:
    """Find a parameter file by the name of one in ``config/ros``, or by a path to a ``.yaml``.

    Raises ValueError if there is none.
    """
    presets = share() / "config" / "ros"
    is_path = name_or_path.endswith((".yaml", ".yml"))
    path = Path(name_or_path) if is_path else presets / f"{name_or_path}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in presets.glob("*.yaml")))
        raise ValueError(f"params_file:={name_or_path}: there is {known}, or a .yaml file")
    return str(path)


def share() -> Path:
    """Return the folder of the installed package's files."""
    return Path(get_package_share_directory("gtmr"))
