# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the launch files have in common; needs ``launch`` and ``launch_ros``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument
from launch_ros.actions import Node

from gtmr_msgs_py.start.environment import SINGLE_THREADED_ALGEBRA


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


MODE = Argument("Controller mode: nominal or robust; may change in flight", parameter_of=("nmpc",))
BAG = Argument("New folder to record the flight into; empty for no recording")
LOCKSTEP = Argument(
    "Whether to wait for the command of every odometry: the same flight every time",
    parameter_of=("sim",),
    kind=bool,
)
COMMON = {
    "params_file": Argument(
        "Parameters of all nodes: paper, wind, worst-case, or the path of a .yaml file", "paper"
    ),
    "vehicle": Argument("Name of a preset, or path of a .yaml file", parameter_of=("sim", "nmpc")),
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
    "rviz": Argument("Whether to open RViz", "false", kind=bool),
    "foxglove": Argument("Whether to start foxglove_bridge", "false", kind=bool),
}
"""Arguments of every launch file that flies."""


def declare(arguments: Mapping[str, Argument]) -> list[DeclareLaunchArgument]:
    """Declare launch arguments.

    Parameters
    ----------
    arguments : mapping
        By name.

    Returns
    -------
    list of launch.actions.DeclareLaunchArgument
    """
    return [
        DeclareLaunchArgument(name, default_value=a.default, description=a.description)
        for name, a in arguments.items()
    ]


def values(arguments: Mapping[str, Argument], given: Mapping[str, str]) -> dict[str, Any]:
    """Read the arguments that were given, as what they are.

    Parameters
    ----------
    arguments : mapping
        By name.
    given : mapping
        Text by name, as ``context.launch_configurations`` has it; empty is not given.

    Returns
    -------
    dict
        Values by name.

    Raises
    ------
    ValueError
        If a text is not of the argument's kind.
    """
    return {name: _value(name, a, given[name]) for name, a in arguments.items() if given[name]}


def _value(name: str, argument: Argument, text: str) -> Any:
    if argument.kind is str:
        return text
    value = yaml.safe_load(text)
    # Whole numbers do for floats, in lists too.
    if argument.kind is float and type(value) is int:
        return float(value)
    if type(value) is list and argument.kind is list:
        return [float(item) for item in value]
    if type(value) is not argument.kind:
        raise ValueError(f"{name}:={text}: expected {argument.kind.__name__}")
    return value


def node(
    executable: str,
    arguments: Mapping[str, Argument],
    given: Mapping[str, Any],
    parameters: Mapping[str, Any],
    **options: Any,
) -> Node:
    """Start a node of the suite.

    Parameters
    ----------
    executable : str
        ``sim``, ``nmpc`` or ``monitor``.
    arguments : mapping
        Of the launch file.
    given : mapping
        Their values.
    parameters : mapping
        Further parameters of this node, which win over what was given.
    **options
        For launch_ros.actions.Node.

    Returns
    -------
    launch_ros.actions.Node
    """
    set_by_argument = {n: v for n, v in given.items() if executable in arguments[n].parameter_of}
    return Node(
        package="gtmr",
        executable=executable,
        parameters=[parameter_file(given["params_file"]), {**set_by_argument, **parameters}],
        additional_env=SINGLE_THREADED_ALGEBRA,
        output="screen",
        **options,
    )


def views(given: Mapping[str, Any]) -> list[Node]:
    """Start the viewers that were asked for.

    Parameters
    ----------
    given : mapping
        Values of the arguments.

    Returns
    -------
    list of launch_ros.actions.Node
    """
    use_sim_time = [{"use_sim_time": True}]
    nodes = []
    if given["rviz"]:
        config = str(share() / "rviz" / "inspection.rviz")
        nodes.append(
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", config],
                parameters=use_sim_time,
            )
        )
    if given["foxglove"]:
        nodes.append(
            Node(
                package="foxglove_bridge",
                executable="foxglove_bridge",
                parameters=use_sim_time,
            )
        )
    return nodes


def parameter_file(name_or_path: str) -> str:
    """Find a parameter file by its name or path.

    Parameters
    ----------
    name_or_path : str
        Name of a file in ``config/ros``, or a path that ends in ``.yaml`` or ``.yml``.

    Returns
    -------
    str
        Its path.

    Raises
    ------
    ValueError
        If there is none.
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
