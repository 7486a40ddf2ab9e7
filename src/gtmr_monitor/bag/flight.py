# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""From the messages of a bag to a flight; needs no ROS."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_model import ConfigError, Helix, Tower, YamlModel
from gtmr_model.uncertainty import N_ZETA
from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.reader import is_whole, read_messages
from gtmr_monitor.flight import Flight, Margins

Array = NDArray[np.float64]
Parameters = dict[str, dict[str, Any]]
TimedMessage = tuple[int, Any]
T = TypeVar("T")

# The names of gtmr_msgs_py.topics, which cannot be imported without ROS.
ODOM = "odom"
ROTOR_STATES = "rotor_states"
ROTOR_COMMAND = "rotor_command"
TIGHTENING = "tightening"
SOLVE_TIME = "solve_time"
CLEARANCE_RESIDUAL = "clearance_residual"
PARAMETER_EVENTS = "/parameter_events"
_TYPES = {
    ODOM: "nav_msgs/msg/Odometry",
    ROTOR_STATES: "sensor_msgs/msg/JointState",
    ROTOR_COMMAND: "trajectory_msgs/msg/JointTrajectory",
    TIGHTENING: "std_msgs/msg/Float64MultiArray",
    SOLVE_TIME: "std_msgs/msg/Float64",
    CLEARANCE_RESIDUAL: "std_msgs/msg/Float64",
}
_MARGIN_COLUMNS = N_ZETA + 3
# Indexed by the type of a rcl_interfaces/msg/ParameterValue.
_VALUE_FIELDS = (
    None, "bool_value", "integer_value", "double_value", "string_value", "byte_array_value",
    "bool_array_value", "integer_array_value", "double_array_value", "string_array_value",
)  # fmt: skip


def read_flight(
    path: str | Path,
    namespace: str | None = None,
    renamed: Mapping[str, str] | None = None,
) -> Flight:
    """Read the flight that a bag recorded.

    Where the simulation was reset, the flight is what came after the last reset. A bag without an
    end is read up to its last whole chunk, with a ``TruncatedBagWarning``.

    Parameters
    ----------
    path : str or pathlib.Path
        A rosbag2 folder, with or without its metadata.yaml, or an MCAP file.
    namespace : str, optional
        Of the vehicle's nodes, for example ``/hex1``; needed if there are several in the bag.
    renamed : mapping, optional
        Topics of a bag from elsewhere, and what they are called here.

    Returns
    -------
    Flight

    Raises
    ------
    BagError
        If the path is not a bag, or holds no odometry or that of several vehicles.
    """
    path = Path(path)
    by_topic: dict[str, list[TimedMessage]] = defaultdict(list)
    for message in read_messages(path):
        topic = _renamed(message.topic, renamed or {})
        if _is_wanted(topic, message.msgtype):
            by_topic[topic].append((message.log_time_ns, message.decode()))
    namespace = _namespace(path, by_topic) if namespace is None else namespace.rstrip("/")
    odometry = _one_flight(by_topic[f"{namespace}/{ODOM}"])
    if not odometry:
        raise BagError(f"{path}: holds no odometry on {namespace}/{ODOM}")
    log_ns = np.array([log for log, _ in odometry])
    stamps_ns = np.array([_stamp_ns(m) for _, m in odometry])

    def recorded(name: str) -> list[TimedMessage]:
        return [(t, m) for t, m in by_topic[f"{namespace}/{name}"] if t >= log_ns[0]]

    def flight_time(stamps: ArrayLike) -> Array:
        since_start: Array = (np.asarray(stamps, dtype=np.int64) - stamps_ns[0]) * 1e-9
        return since_start

    def latest_stamp(logged_ns: Sequence[int]) -> NDArray[np.int64]:
        index = np.searchsorted(log_ns, np.array(logged_ns, dtype=np.int64), side="right") - 1
        return stamps_ns[np.clip(index, 0, None)]

    commands = strictly_later([_stamp_ns(m) for _, m in recorded(ROTOR_COMMAND)])

    def step_times(messages: list[TimedMessage]) -> Array:
        """Stamps of the commands, as one step sends one of each; failing that, of the odometry."""
        if len(commands) == len(messages):
            return flight_time(commands)
        return flight_time(latest_stamp([log for log, _ in messages]))

    parameters, modes = _parameters(by_topic[PARAMETER_EVENTS], namespace)
    sim, nmpc = (parameters.get(f"{namespace}/{node}", {}) for node in ("sim", "nmpc"))
    monitor = parameters.get(f"{namespace}/monitor", {})
    poses = np.array([_pose(m) for _, m in odometry])
    rotors = strictly_later(recorded(ROTOR_STATES), key=lambda item: _stamp_ns(item[1]))
    solve = recorded(SOLVE_TIME)
    tightening = recorded(TIGHTENING)
    mode_times = flight_time(latest_stamp([log for log, _ in modes])).tolist()
    return Flight(
        name=path.resolve().stem,
        source=path,
        t=flight_time(stamps_ns),
        p=poses[:, :3],
        eta=_roll_pitch_yaw(poses[:, 3:]),
        recorded_residual=np.array([m.data for _, m in recorded(CLEARANCE_RESIDUAL)]),
        t_rotors=flight_time([_stamp_ns(m) for _, m in rotors]),
        rotor_speed_hz=_rows([m.velocity for _, m in rotors]) / (2.0 * math.pi),
        margins=_margins(path, step_times(tightening), tightening),
        t_solve=step_times(solve),
        solve_ms=np.array([1e3 * m.data for _, m in solve]),
        modes=_since_start([(t, mode) for t, (_, mode) in zip(mode_times, modes, strict=True)]),
        deadline_ms=1e3 * float(nmpc.get("sampling_time_s", math.nan)),
        tower=_model(path, Tower, "tower", (monitor, sim, nmpc)),
        helix=_model(path, Helix, "helix", (nmpc, sim)),
        zeta=tuple(sim["zeta"]) if "zeta" in sim else None,
        gust=sim.get("gust.kind"),
        seed=sim.get("seed"),
        parameters=parameters,
        truncated=not is_whole(path),
    )


def _renamed(topic: str, renamed: Mapping[str, str]) -> str:
    """Call a topic as it is called here; one whose name another takes over drops out."""
    return renamed.get(topic, "" if topic in renamed.values() else topic)


def _is_wanted(topic: str, msgtype: str) -> bool:
    name = topic.rpartition("/")[2]
    return topic == PARAMETER_EVENTS or _TYPES.get(name) == msgtype


def _namespace(path: Path, topics: Iterable[str]) -> str:
    found = sorted(t.removesuffix(f"/{ODOM}") for t in topics if t.endswith(f"/{ODOM}"))
    if not found:
        raise BagError(f"{path}: not a flight: holds no odometry on a topic named {ODOM}")
    if len(found) > 1:
        raise BagError(f"{path}: holds several vehicles, name one: {', '.join(found)}")
    return found[0]


def _one_flight(odometry: list[TimedMessage]) -> list[TimedMessage]:
    """Usable odometry after the last reset, each stamp once: waiting nodes repeat themselves."""
    resets = [
        k
        for k, ((_, before), (_, after)) in enumerate(pairwise(odometry), start=1)
        if _stamp_ns(after) < _stamp_ns(before)
    ]
    flown = odometry[resets[-1] if resets else 0 :]
    finite = [item for item in flown if math.isfinite(sum(_pose(item[1])))]
    return strictly_later(finite, key=lambda item: _stamp_ns(item[1]))


def strictly_later(items: Iterable[T], key: Callable[[T], Any] = lambda item: item) -> list[T]:
    """Leave out what is not later than all that came before.

    Parameters
    ----------
    items : iterable
        In the order of their arrival.
    key : callable
        Gives the time of an item; the item itself if left out.

    Returns
    -------
    list
    """
    kept: list[T] = []
    for item in items:
        if not kept or key(item) > key(kept[-1]):
            kept.append(item)
    return kept


def _parameters(
    events: list[TimedMessage], namespace: str
) -> tuple[Parameters, list[tuple[int, str]]]:
    """Last value of every parameter, and every change of the controller's mode."""
    parameters: Parameters = defaultdict(dict)
    modes: list[tuple[int, str]] = []
    for log_ns, event in events:
        node = parameters[event.node]
        for parameter in (*event.new_parameters, *event.changed_parameters):
            node[parameter.name] = parameter_value(parameter.value)
        for parameter in event.deleted_parameters:
            node.pop(parameter.name, None)
        mode = node.get("mode")
        if event.node == f"{namespace}/nmpc" and mode and (not modes or modes[-1][1] != mode):
            modes.append((log_ns, mode))
    return dict(parameters), modes


def parameter_value(value: Any) -> Any:
    """Read a ``rcl_interfaces/msg/ParameterValue`` from a bag.

    Parameters
    ----------
    value : Any
        The message.

    Returns
    -------
    bool, int, float, str, list or None
    """
    name = _VALUE_FIELDS[value.type] if value.type < len(_VALUE_FIELDS) else None
    plain = getattr(value, name) if name else None
    return plain.tolist() if isinstance(plain, np.ndarray) else plain


def _since_start(modes: list[tuple[float, str]]) -> tuple[tuple[float, str], ...]:
    """Modes flown; the first holds from the start, as its parameters may be fetched late."""
    begun = [k for k, (t, _) in enumerate(modes) if t <= 0.0]
    flown = modes[begun[-1] if begun else 0 :]
    return tuple((t if k else 0.0, mode) for k, (t, mode) in enumerate(flown))


def _model(path: Path, kind: type[Any], prefix: str, candidates: Iterable[dict[str, Any]]) -> Any:
    """Build the tower or the helix from the first node that has it; the defaults if none has."""
    for parameters in candidates:
        fields = {
            name.removeprefix(f"{prefix}."): value
            for name, value in parameters.items()
            if name.startswith(f"{prefix}.")
        }
        if fields:
            try:
                model: YamlModel = kind.parse(fields, str(path))
            except ConfigError as error:
                raise BagError(str(error)) from None
            return model
    return kind()


def _margins(path: Path, t: Array, messages: list[TimedMessage]) -> Margins:
    rows = [np.asarray(m.data) for _, m in messages]
    if any(row.size % _MARGIN_COLUMNS or row.size != rows[0].size for row in rows):
        raise BagError(f"{path}: {TIGHTENING} does not hold {_MARGIN_COLUMNS} numbers a stage")
    stages = rows[0].size // _MARGIN_COLUMNS if rows else 0
    table = np.array(rows).reshape(len(rows), stages, _MARGIN_COLUMNS)
    return Margins(t, table[:, :, :N_ZETA], *np.moveaxis(table[:, :, N_ZETA:], 2, 0))


def _stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _pose(odometry: Any) -> tuple[float, ...]:
    p, q = odometry.pose.pose.position, odometry.pose.pose.orientation
    return (p.x, p.y, p.z, q.x, q.y, q.z, q.w)


def _rows(vectors: list[Array]) -> Array:
    """Stack the vectors that are as long as the first."""
    return np.array([v for v in vectors if v.size == vectors[0].size] or np.zeros((0, 0)))


def _roll_pitch_yaw(quaternions: Array) -> Array:
    """Roll, pitch, yaw [rad] of quaternions in rows x, y, z, w; yaw goes on over +-pi."""
    x, y, z, w = quaternions.T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack([roll, pitch, np.unwrap(yaw)])
