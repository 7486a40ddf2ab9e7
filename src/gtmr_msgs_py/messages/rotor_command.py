# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The controller's whole plan as trajectory_msgs/JointTrajectory."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from trajectory_msgs.msg import JointTrajectory

from gtmr_msgs_py.contract import RAD_PER_TURN, rotor_names
from gtmr_msgs_py.wire import stamps
from gtmr_msgs_py.wire.fixed_cdr import FixedCdr
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_msgs_py.wire.reading import read


@dataclass(frozen=True)
class RotorPlan:
    """Commands for the rotors over the horizon."""

    stamp_ns: int
    """Time from which it acts: the stamp of the odometry that it was planned from, plus the delay
    [ns]."""
    step_ns: int
    """T_s, time from one point to the next [ns]."""
    xi: NDArray[np.float64]
    """Speed setpoints [Hz], linear in between, shape (N + 1, N_p)."""
    u: NDArray[np.float64]
    """Rotor accelerations [Hz/s], row i held from i T_s to (i + 1) T_s, shape (N, N_p)."""


def decode(msg: JointTrajectory, n_rotors: int) -> RotorPlan:
    """Read the plan out of a command; the accelerations of the last point are left out.

    Raises MessageError if rotors or points are missing, points are not evenly spaced in time from
    zero on or numbers are not finite.
    """
    expected = rotor_names(n_rotors)
    if list(msg.joint_names) != expected:
        raise MessageError(
            f"rotor_command is for {list(msg.joint_names)}: expected {', '.join(expected)}",
            "vehicle",
        )
    if len(msg.points) < 2:
        raise MessageError(f"rotor_command has {len(msg.points)} points: expected at least 2")
    sizes = {len(p.velocities) for p in msg.points} | {len(p.accelerations) for p in msg.points}
    if sizes != {n_rotors}:
        raise MessageError(
            f"rotor_command has points of {sorted(sizes)} numbers: expected {n_rotors}",
            "vehicle",
        )
    times_ns = [stamps.decode(point.time_from_start) for point in msg.points]
    step_ns = times_ns[1]
    if step_ns <= 0 or times_ns != [i * step_ns for i in range(len(times_ns))]:
        raise MessageError(f"rotor_command has points at {times_ns} ns: expected an even spacing")
    xi = np.array([point.velocities for point in msg.points]) / RAD_PER_TURN
    u = np.array([point.accelerations for point in msg.points[:-1]]) / RAD_PER_TURN
    return _finite(RotorPlan(stamps.decode(msg.header.stamp), step_ns, xi, u))


def pack(stamp_ns: int, step_ns: int, xi: ArrayLike, u: ArrayLike) -> bytes:
    """Make CDR bytes of a trajectory_msgs/JointTrajectory of N + 1 points, T_s (step_ns) apart.

    Stamp from which it acts [ns], rotor speed setpoints xi [Hz], shape (N + 1, N_p),
    accelerations u [Hz/s], shape (N, N_p); at the last point these are zero: hold that speed.
    """
    points = _points(xi, u)
    return _layout(step_ns, len(points), points.shape[2]).pack(stamp_ns, points.ravel())


class Reader:
    """Reads commands from bytes; a command of the same layout as the last is not parsed again."""

    def __init__(self, n_rotors: int) -> None:
        self._n_rotors = n_rotors
        self._step_ns = 0
        self._layout: FixedCdr | None = None

    def unpack(self, data: bytes) -> RotorPlan:
        """Read the plan as `decode` does, out of CDR bytes from anywhere.

        Raises MessageError for what `decode` refuses, and for what is no such message.
        """
        unpacked = None if self._layout is None else self._layout.unpack(data)
        if unpacked is None:
            plan = decode(read(data, JointTrajectory), self._n_rotors)
            self._step_ns = plan.step_ns
            self._layout = _layout(plan.step_ns, *plan.xi.shape)
            return plan
        stamp_ns, numbers = unpacked
        points = numbers.reshape(-1, 2, self._n_rotors) / RAD_PER_TURN
        return _finite(RotorPlan(stamp_ns, self._step_ns, points[:, 0], points[:-1, 1]))


def _points(xi: ArrayLike, u: ArrayLike) -> NDArray[np.float64]:
    """Velocities and accelerations as messages have them, shape (N + 1, 2, N_p) [rad/s, ...]."""
    xi = np.asarray(xi, dtype=float)
    points = np.zeros((len(xi), 2, xi.shape[1]))
    points[:, 0] = xi
    points[:-1, 1] = u
    return RAD_PER_TURN * points


def _finite(plan: RotorPlan) -> RotorPlan:
    if not (np.isfinite(plan.xi).all() and np.isfinite(plan.u).all()):
        raise MessageError("rotor_command has numbers that are not finite")
    return plan


@lru_cache(maxsize=4)
def _layout(step_ns: int, n_points: int, n_rotors: int) -> FixedCdr:
    layout = FixedCdr()
    layout.header()
    layout.strings(rotor_names(n_rotors))
    layout.uint32(n_points)
    for i in range(n_points):
        # Neither positions nor efforts.
        layout.uint32(0, n_rotors)
        layout.float64(n_rotors)
        layout.uint32(n_rotors)
        layout.float64(n_rotors)
        layout.uint32(0, *divmod(i * step_ns, stamps.NANOSECONDS))
    return layout
