# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Writes docs/interfaces.md and config/parameters.yaml from the code.

Run `.venv/bin/python docs/interfaces.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from gtmr_monitor.node import MonitorNode, MonitorParameters
from gtmr_msgs_py import topics
from gtmr_msgs_py.node.declarations import Declaration, declarations
from gtmr_nmpc.node import NmpcNode, NmpcParameters
from gtmr_sim.node import SimNode, SimParameters

PAGE = Path(__file__).with_suffix(".md")
PARAMETER_FILE = Path(__file__).parents[1] / "config" / "parameters.yaml"
NODES = {
    "sim": (SimNode, SimParameters),
    "nmpc": (NmpcNode, NmpcParameters),
    "monitor": (MonitorNode, MonitorParameters),
}
"""Node and parameters by name."""
INTRODUCTION = """\
# Topics, services and parameters

Generated from the code by `docs/interfaces.py`; a test keeps the two equal.

Names are relative, so that namespaces and remaps work, unless they start with a slash. Frames
are `map` (ENU) and `base_link` (FLU).
"""
LAUNCH_FILES = """\
## Launch files

`inspection.launch.py` flies, `compare.launch.py` flies nominal and robust side by side,
`replay.launch.py bag:=...` plays a bag to controller and monitor. `--show-args` lists what each
takes. What is not given comes from the parameter file.

| argument | in | meaning |
| --- | --- | --- |
| `params_file:=` | all | `paper`, `wind`, `worst-case`, or the path of a .yaml file |
| `mode:=` | inspection, replay | mode of the controller at the start |
| `vehicle:=` | all | name of a preset, or path of a .yaml file |
| `world:=` | all | what the vehicle meets: name of a preset, or path of a .yaml file |
| `controller:=` | all | name of a preset, or path of a .yaml file, as that of its world |
| `bag:=` | all | new folder to record into; for replay the bag to play |
| `record:=` | replay | new folder to record into |
| `rate:=`, `loop:=` | replay | how many times as fast as recorded; whether to repeat |
| `lockstep:=` | inspection | wait for the command for every odometry: the flight is repeatable |
| `zeta:=`, `sample_zeta:=` | inspection, compare | true mismatch and wind bias, or drawn |
| `seed:=` | inspection, compare | of the gusts, and of the mismatch if it is drawn |
| `real_time_factor:=` | inspection, compare | simulated time per wall time |
| `duration_s:=` | inspection, compare | end of the flight [s]; 0 is never |
| `namespace:=`, `log_level:=` | all | of all nodes |
| `respawn:=3` | all | how often a controller or monitor that failed is started again |
| `managed:=true` | all | lifecycle services; nodes are configured and activated too |
| `rviz:=true`, `foxglove:=true` | all | viewers |
| `address:=` | all | where foxglove_bridge listens; 127.0.0.1 if left out |

Every process ends with the launch. The launch ends with the first node that ends for good, with
exit code 1 if that node failed. Who can reach the nodes is in [security.md](security.md).
"""
DIAGNOSTICS = """\
They are published once a second, and at once when something stops or the guard takes charge.
Beside the figures of the controller, the flight and the bag there are:

- `dropped_undecodable` (all): bytes that are not such a message, or numbers that make no sense.
- `dropped_frame` (nmpc, monitor): odometry of other frames than `world_frame` and `body_frame`.
- `dropped_vehicle` (nmpc, sim): other rotors, by number or name.
- `dropped_late` (all): older than what came before. What is at most 0.5 s late the monitor
  counts as `late_odometry`, and uses.
- `dropped_future` (all): more than 1 s ahead of what came before, unless three in a row agree.
- `dropped_jump` (nmpc): odometry that the vehicle cannot have reached, unless it lasts 0.1 s.
- `callback_errors` (all): messages at which a callback failed; the node goes on, the log says
  where.
- `delay_s` (nmpc): age of the odometry by simulated time, or else the computer's; `unknown` if its
  stamps are of neither clock, or of one of several simulations.
- `withheld_commands` (nmpc): steps that sent no command, for the reason in the message: odometry
  older than `max_delay_s`, a solver that failed for more than 0.1 s, a vehicle that is inverted or
  too fast.
- `qp_status` (nmpc): `solved`; `softened` if the plan needs slack; `limited` if the solver stopped
  before its solution, with a plan that keeps the limits of the rotors; `failed` if it found no
  finite numbers. `softened_in_window` and the like count the last 400 steps.
- `guard`, `guard_cause`, `guard_time_s` (sim): whether the guard is in charge, why, and for how
  long it was.

Each cause is logged as a warning at once, and then every 5 s. Time that goes back by more than
0.5 s, or to zero, begins another flight once three messages in a row agree. Odometry or commands
that came at 20 Hz or faster and stop are reported within 0.2 s of wall time. (Deadlines of the
middleware would exclude every publisher that does not offer one.) Where the simulator waits for
commands, in lockstep, `delay_s` is 0 at any real-time factor.
"""
PARAMETERS = """\
A parameter marked *in flight* may change while the node runs, by `ros2 param set`, its service,
or several at once by `set_parameters_atomically`: it takes effect at the next controller
or simulator step. All others are read-only after the start. A value that is refused changes
nothing, and the reply says why. Files of parameters for all nodes are in `config/ros`; every
node also has what every ROS 2 node has, such as `use_sim_time`. `config/parameters.yaml` has every
parameter with its default, to copy from.

A name that does not exist is refused at the start, on the command line and in files. A section
for all nodes (`/**`) may contain parameters that only some nodes have.

After a switch of `mode` the margins come or go over `switch_time_s`, so that the commands make
no jump. Each node has its own `tower.min_clearance_m`: set it in all three.
"""


def page() -> str:
    """Return the whole page, in Markdown."""
    parts = [INTRODUCTION, "## Topics\n", _topics(), "## Services\n", _services()]
    parts += [LAUNCH_FILES, "## Diagnostics\n", DIAGNOSTICS, "## Parameters\n", PARAMETERS]
    for name, (node, model) in NODES.items():
        parts += [
            f"### `{name}`\n",
            _parameters(declarations(model(), node.PRESETS, node.DYNAMIC)),
        ]
    return "\n".join(parts)


def parameter_file() -> str:
    """Return a parameter file of all nodes with every default, in YAML."""
    lines = ["# Every parameter with its default; docs/interfaces.md says what each means.\n"]
    for name, (node, model) in NODES.items():
        lines.append(f"/**/{name}:\n  ros__parameters:\n")
        for declared in declarations(model(), node.PRESETS, node.DYNAMIC):
            lines.append(f"    {declared.name}: {_text(declared.value)}\n")
    return "".join(lines)


def _topics() -> str:
    # What stands in the page must not depend on the machine: tf2_msgs may be missing.
    rows = [
        (
            f"`{t.name}`",
            t.type_name,
            ", ".join(t.publishers),
            ", ".join(t.subscribers),
            t.content,
        )
        for t in topics.TOPICS
        if t.name != "tf"
    ]
    heads = ("topic", "type", "published by", "needed by", "content")
    absent = (
        "\n`tf` (tf2_msgs/msg/TFMessage, by sim) is published where `tf2_msgs` is installed.\n"
    )
    return _table(heads, rows) + absent


def _services() -> str:
    rows = [(f"`{s.name}`", s.type_name, s.server, s.content) for s in topics.SERVICES]
    return _table(("service", "type", "served by", "effect"), rows)


def _parameters(declared: Iterable[Declaration]) -> str:
    rows = [
        (
            f"`{d.name}`",
            "" if d.descriptor.read_only else "in flight",
            f"`{_text(d.value)}`",
            _range(d),
            d.descriptor.description,
        )
        for d in declared
    ]
    return _table(("parameter", "changes", "default", "allowed", "meaning and unit"), rows)


def _range(declared: Declaration) -> str:
    limits = [*declared.descriptor.floating_point_range, *declared.descriptor.integer_range]
    if declared.descriptor.additional_constraints or not limits:
        return str(declared.descriptor.additional_constraints)
    low, high = limits[0].from_value, limits[0].to_value
    return f"{low:g} to {high:g}" if math.isfinite(high) else f"at least {low:g}"


def _text(value: object) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(map(_text, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value!r}" if not isinstance(value, str) else f'"{value}"'


def _table(heads: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [heads, tuple("---" for _ in heads), *rows]
    return "".join("| " + " | ".join(c.replace("|", "\\|") for c in row) + " |\n" for row in lines)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    PARAMETER_FILE.write_text(parameter_file(), encoding="utf-8")
