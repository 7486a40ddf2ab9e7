# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""The controller's whole plan as trajectory_msgs/JointTrajectory."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from builtin_interfaces.msg import Duration
from numpy.typing import ArrayLike, NDArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from gtmr_msgs_py import stamps
from gtmr_msgs_py.message_error import MessageError
from gtmr_msgs_py.rotor_states import RAD_PER_TURN, rotor_names


@dataclass(frozen=True)
class RotorPlan:
    """What the rotors shall do over the horizon."""

    stamp_ns: int
    """Stamp of the odometry that it was planned from [ns]."""
    step_ns: int
    """T_s, time from one point to the next [ns]."""
    xi: NDArray[np.float64]
    """Rotor speeds [Hz], shape (N + 1, N_p)."""
    u: NDArray[np.float64]
    """Rotor accelerations [Hz/s], row i held from i T_s to (i + 1) T_s, shape (N, N_p)."""


def encode(stamp_ns: int, step_ns: int, xi: ArrayLike, u: ArrayLike) -> JointTrajectory:
    """Make a command of a plan.

    Parameters
    ----------
    stamp_ns : int
        Stamp of the odometry that it was planned from [ns].
    step_ns : int
        T_s [ns].
    xi : array_like, shape (N + 1, N_p)
        Planned rotor speeds [Hz].
    u : array_like, shape (N, N_p)
        Planned rotor accelerations [Hz/s].

    Returns
    -------
    trajectory_msgs.msg.JointTrajectory
        N + 1 points; at the last one the accelerations are zero: hold that speed.
    """
    velocities = RAD_PER_TURN * np.asarray(xi, dtype=float)
    accelerations = RAD_PER_TURN * np.asarray(u, dtype=float)
    accelerations = np.vstack([accelerations, np.zeros(accelerations.shape[1])])
    # From lists and with the times of the last command: this is on the way of every command.
    points = [
        JointTrajectoryPoint(
            velocities=array("d", velocity),
            accelerations=array("d", acceleration),
            time_from_start=time_from_start,
        )
        for velocity, acceleration, time_from_start in zip(
            velocities.tolist(),
            accelerations.tolist(),
            _times_from_start(step_ns, len(velocities)),
            strict=True,
        )
    ]
    msg = JointTrajectory(joint_names=rotor_names(velocities.shape[1]), points=points)
    msg.header.stamp = stamps.encode(stamp_ns)
    return msg


@lru_cache(maxsize=2)
def _times_from_start(step_ns: int, count: int) -> tuple[Duration, ...]:
    return tuple(stamps.encode_duration(i * step_ns) for i in range(count))


def decode(msg: JointTrajectory, n_rotors: int) -> RotorPlan:
    """Read the plan out of a command.

    Parameters
    ----------
    msg : trajectory_msgs.msg.JointTrajectory
        Points evenly spaced in time from zero on.
    n_rotors : int
        N_p, how many rotors the vehicle has.

    Returns
    -------
    RotorPlan
        The accelerations of the last point are left out.

    Raises
    ------
    MessageError
        If rotors or points are missing, points are not evenly spaced or numbers are not finite.
    """
    expected = rotor_names(n_rotors)
    if list(msg.joint_names) != expected:
        raise MessageError(
            f"rotor_command is for {list(msg.joint_names)}: expected {', '.join(expected)}"
        )
    if len(msg.points) < 2:
        raise MessageError(f"rotor_command has {len(msg.points)} points: expected at least 2")
    sizes = {len(p.velocities) for p in msg.points} | {len(p.accelerations) for p in msg.points}
    if sizes != {n_rotors}:
        raise MessageError(
            f"rotor_command has points of {sorted(sizes)} numbers: expected {n_rotors}"
        )
    times_ns = [stamps.decode(point.time_from_start) for point in msg.points]
    step_ns = times_ns[1]
    if step_ns <= 0 or times_ns != [i * step_ns for i in range(len(times_ns))]:
        raise MessageError(f"rotor_command has points at {times_ns} ns: expected an even spacing")
    xi = np.array([point.velocities for point in msg.points]) / RAD_PER_TURN
    u = np.array([point.accelerations for point in msg.points[:-1]]) / RAD_PER_TURN
    if not (np.isfinite(xi).all() and np.isfinite(u).all()):
        raise MessageError("rotor_command has numbers that are not finite")
    return RotorPlan(stamps.decode(msg.header.stamp), step_ns, xi, u)
