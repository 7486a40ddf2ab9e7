# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Reading the flights that a bag recorded, for reports and notebooks."""

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_model import ConfigError, ReferencePath, Tower, Vehicle
from gtmr_model.uncertainty import N_ZETA
from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.recording import Change, Recorded, Recording
from gtmr_monitor.bag.vehicles import read_recordings
from gtmr_monitor.flight import Flight, MarginHistory
from gtmr_msgs_py.contract import (
    GROUND_TRUTH,
    ODOM,
    RAD_PER_TURN,
    TIGHTENING_COLUMNS,
    TIGHTENING_STAGE,
)
from gtmr_msgs_py.wire.stamps import NANOSECONDS

Array = NDArray[np.float64]


def read_flights(path: str | Path, vehicle: str | None = None) -> list[Flight]:
    """Read the flights of all vehicles in a bag, or of one of them.

    Where the simulation was reset, a flight is what came after the last reset. Of a damaged bag
    it is what is left, with a ``DamagedBagWarning``, and its ``coverage`` says how much that is.
    A bag is a rosbag2
    folder, with or without its metadata.yaml, or an MCAP file; a vehicle is the namespace of its
    nodes, for example ``hex1`` or ``/hex1``, or ``/`` for none.

    Raises BagError if the path is not a bag, or holds no odometry on a topic ``odom``, or not that
    vehicle's.
    """
    return [flight_of(recording) for recording in read_recordings(path, vehicle)]


def read_flight(path: str | Path, vehicle: str | None = None) -> Flight:
    """Read a flight as `read_flights` does, of a bag with one vehicle or of the one named.

    Raises BagError as `read_flights`, and if there are several vehicles and none is named.
    """
    recordings = read_recordings(path, vehicle)
    if len(recordings) > 1:
        names = ", ".join(each.odom.rpartition("/")[0] or "/" for each in recordings)
        raise BagError(f"{path}: holds several vehicles, name one: {names}")
    return flight_of(recordings[0])


def flight_of(recording: Recording) -> Flight:
    """Make arrays of a recording, in the units of a flight.

    Raises BagError if recorded parameters make no tower or helix.
    """
    path, odometry = recording.path, recording.odometry
    truth = recording.ground_truth or odometry
    by_arrival = sorted(odometry, key=lambda item: item.received_ns)
    received_ns = np.array([item.received_ns for item in by_arrival])
    newest_ns = np.maximum.accumulate(np.array([item.stamp_ns for item in by_arrival]))

    def flight_time(stamps_ns: ArrayLike) -> Array:
        since_start_ns = np.asarray(stamps_ns, dtype=np.int64) - recording.start_ns
        return np.asarray(since_start_ns / NANOSECONDS, dtype=float)

    def time_of(items: Sequence[Recorded | Change]) -> Array:
        """Time of the newest odometry when something was received."""
        at_ns = np.array([item.received_ns for item in items], dtype=np.int64)
        index = np.searchsorted(received_ns, at_ns, side="right") - 1
        return flight_time(newest_ns[np.clip(index, 0, None)])

    def step_times(items: list[Recorded]) -> Array:
        """Stamps of the commands, as one step sends one of each; failing that, of the odometry."""
        if len(recording.command_order) == len(items):
            return flight_time(recording.command_order)
        return time_of(items)

    parameters: dict[str, dict[str, Any]] = defaultdict(dict)
    for change in recording.changes:
        parameters[change.node] |= change.values
    sim, nmpc, monitor = (
        parameters.get(f"{recording.namespace}/{node}", {}) for node in ("sim", "nmpc", "monitor")
    )
    switches = [change for change in recording.controller_changes if change.values.get("mode")]
    rotors, commands = recording.rotor_states, recording.commands
    tower = _model(path, Tower, "tower", (monitor, sim, nmpc))
    notes = list(recording.notes)
    if recording.before_reset:
        closest_m = tower.clearance(_positions(recording.before_reset)).min()
        notes.append(
            f"the simulation began again: of the {len(recording.before_reset)} odom messages "
            f"before that, which are left out, the least clearance is {closest_m:.3f} m"
        )
    margins = _margins(step_times(recording.tightening), recording.tightening, notes)
    return Flight(
        name=recording.name,
        source=path,
        t=flight_time([item.stamp_ns for item in truth]),
        p=_positions(truth),
        eta=_roll_pitch_yaw(truth),
        recorded_residual=np.array([item.message.data for item in recording.residuals]),
        t_rotors=flight_time([item.stamp_ns for item in rotors]),
        rotor_speed_hz=_rows([item.message.velocity for item in rotors]) / RAD_PER_TURN,
        margins=margins,
        t_solve=step_times(recording.solve_times),
        solve_ms=np.array([1e3 * item.message.data for item in recording.solve_times]),
        modes=_modes(time_of(switches).tolist(), [change.values["mode"] for change in switches]),
        deadline_ms=1e3 * float(nmpc.get("sampling_time_s", math.nan)),
        tower=tower,
        helix=_model(path, ReferencePath, "helix", (nmpc, sim)),
        coverage=recording.coverage,
        clearance_from=(GROUND_TRUTH if recording.ground_truth else ODOM).name,
        vehicle=_vehicle((sim, nmpc)),
        guarded=_guarded(
            time_of(recording.guard), [item.message.data for item in recording.guard]
        ),
        zeta=tuple(sim["zeta"]) if "zeta" in sim else None,
        gust=sim.get("gust.kind"),
        seed=sim.get("seed"),
        parameters=dict(parameters),
        t_command=flight_time([item.stamp_ns for item in commands]),
        command_hz_s=_first_accelerations(commands),
        truncated=recording.truncated,
        late=recording.late,
        notes=tuple(notes),
    )


def _positions(odometry: list[Recorded]) -> Array:
    """World ENU [m], shape (n, 3)."""
    points = [item.message.pose.pose.position for item in odometry]
    return np.array([(p.x, p.y, p.z) for p in points])


def _modes(times: list[float], modes: list[str]) -> tuple[tuple[float, str], ...]:
    """Modes flown; the first holds from the start, as its parameters may be fetched late."""
    changed = [k for k, mode in enumerate(modes) if not k or mode != modes[k - 1]]
    begun = [k for k in changed if times[k] <= 0.0]
    first = begun[-1] if begun else 0
    return tuple((times[k] if k > first else 0.0, modes[k]) for k in changed if k >= first)


def _guarded(times: Array, in_charge: list[bool]) -> tuple[tuple[float, float], ...] | None:
    """From when to when it was in charge: up to the message that says it no longer is."""
    if not in_charge:
        return None
    turns = [k for k, now in enumerate(in_charge) if now != (k > 0 and in_charge[k - 1])]
    turns += [len(in_charge) - 1] if in_charge[-1] else []
    return tuple(
        (float(times[begin]), float(times[end]))
        for begin, end in zip(turns[::2], turns[1::2], strict=True)
    )


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
                return kind.parse(fields, str(path))
            except ConfigError as error:
                raise BagError(str(error)) from None
    return kind.parse({}, str(path))


def _vehicle(candidates: Iterable[dict[str, Any]]) -> Vehicle | None:
    """Load the vehicle that a node named; None if none did, or its file is not here."""
    for parameters in candidates:
        if isinstance(name := parameters.get("vehicle"), str):
            try:
                return Vehicle.load("vehicle", name)
            except ConfigError:
                return None
    return None


def _margins(t: Array, items: list[Recorded], notes: list[str]) -> MarginHistory:
    """Margins of the messages that are laid out as the first."""
    rows = [np.asarray(item.message.data) for item in items]
    labels = [_labels(item.message) for item in items]
    columns = labels[0] if labels else TIGHTENING_COLUMNS
    size = rows[0].size if rows and rows[0].size % len(columns) == 0 else 0
    kept = [k for k, row in enumerate(rows) if row.size == size > 0 and labels[k] == columns]
    if len(kept) < len(rows):
        notes.append(
            f"{len(rows) - len(kept)} tightening messages are of another layout: left out"
        )
    table = np.array([rows[k] for k in kept]).reshape(
        len(kept), size // len(columns), len(columns)
    )
    told = {label: table[:, :, k] for k, label in enumerate(columns)}
    ours = [told.pop(label, np.zeros(table.shape[:2])) for label in TIGHTENING_COLUMNS]
    by_channel, (eps_s, alpha_g, slack) = np.stack(ours[:N_ZETA], axis=2), ours[N_ZETA:]
    return MarginHistory(t[kept], by_channel, eps_s, alpha_g, slack, told)


def _labels(message: Any) -> tuple[str, ...]:
    """Columns of a ``tightening`` message; those of the paper where it does not tell."""
    dims = message.layout.dim
    labels = tuple(dims[1].label.split(",")) if len(dims) == 2 else ()
    is_ours = labels and dims[0].label == TIGHTENING_STAGE and len(set(labels)) == len(labels)
    return labels if is_ours else TIGHTENING_COLUMNS


def _rows(vectors: list[Array]) -> Array:
    """Stack the vectors that are as long as the first."""
    return np.array([v for v in vectors if v.size == vectors[0].size] or np.zeros((0, 0)))


def _first_accelerations(commands: list[Recorded]) -> Array:
    """Take what plans command first [Hz/s], shape (c, N_p); NaN where a plan has another shape."""
    first = [item.message.points[:1] for item in commands]
    rows = [np.asarray(point[0].accelerations if point else ()) for point in first]
    n_rotors = max((row.size for row in rows), default=0)
    nothing = np.full(n_rotors, np.nan)
    told = [row if row.size == n_rotors else nothing for row in rows]
    return np.array(told).reshape(len(rows), n_rotors) / RAD_PER_TURN


def _roll_pitch_yaw(odometry: list[Recorded]) -> Array:
    """Roll, pitch, yaw [rad], shape (n, 3); yaw goes on over +-pi."""
    turns = [item.message.pose.pose.orientation for item in odometry]
    x, y, z, w = np.array([(q.x, q.y, q.z, q.w) for q in turns]).T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack([roll, pitch, np.unwrap(yaw)])
