# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The rotor speeds of a recorded flight: measured, or else from the best source there is."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gtmr_model.dynamics import ATTITUDE, RATE, VELOCITY
from gtmr_model.vehicle import GRAVITY_M_S2, Vehicle
from gtmr_monitor.bag.recording import Recording
from gtmr_msgs_py.messages import rotor_states
from gtmr_msgs_py.messages.rotor_command import RotorPlan
from gtmr_msgs_py.wire import stamps
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_study.ros.replay.states import State

Array = NDArray[np.float64]

MAX_GAP_S = 0.1
"""How far apart two messages of rotor speeds may be to interpolate between them [s]."""
SOURCES = {
    "recorded": "measured with the odometry",
    "from_command": "as the recorded command of that step begins",
    "interpolated": "interpolated between messages up to 0.1 s apart",
    "estimated": "estimated: those that hold the vehicle in its measured motion",
}
"""Where the rotor speeds of a step may come from."""


def quasi_static_rotor_speeds(x: ArrayLike, vehicle: Vehicle) -> NDArray[np.float64]:
    """Rotor speeds at which neither the velocity nor the body rate would change, by eq. (3).

    Accelerations are neglected, as differentiating measured velocities brings in more noise than
    the slow flight along a tower has of them; so are wind and mismatch, which nobody knows.

    x begins with [p, eta, v, omega]: m, rad, m/s, rad/s; world ENU, omega in body FLU. The speeds
    [Hz], shape (N_p,), are within the rotors' limits; where they cannot give that wrench, the
    nearest.
    """
    state = np.asarray(x, dtype=float)
    v, omega = state[VELOCITY], state[RATE]
    weight = np.array([0.0, 0.0, vehicle.mass_kg * GRAVITY_M_S2])
    to_world = Rotation.from_euler("ZYX", state[ATTITUDE][::-1])
    force = to_world.inv().apply(weight + vehicle.drag_n_s_per_m * v)
    torque = np.cross(omega, np.multiply(vehicle.inertia_kg_m2, omega))
    squared, *_ = np.linalg.lstsq(vehicle.allocation, np.r_[force, torque], rcond=None)
    speeds: NDArray[np.float64] = np.sqrt(np.maximum(squared, 0.0))
    return speeds.clip(vehicle.min_rotor_speed_hz, vehicle.max_rotor_speed_hz)


class RotorSpeeds:
    """The rotor speeds at the stamps of the odometry, from the best source that there is.

    Stamps of odometry and rotor states that belong together may be ``tolerance_ns`` apart [ns].
    """

    def __init__(self, recording: Recording, vehicle: Vehicle, tolerance_ns: int) -> None:
        self._vehicle = vehicle
        self._tolerance_ns = tolerance_ns
        self.renamed = False
        """Whether the rotors have other names than here, and are taken in order."""
        measured = [
            (item.stamp_ns, xi)
            for item in recording.rotor_states
            if (xi := self._decoded(item.message)) is not None
        ]
        self._stamps = np.array([stamp_ns for stamp_ns, _ in measured], dtype=np.int64)
        self._xi = np.array([xi for _, xi in measured]).reshape(-1, self._vehicle.n_rotors)

    def at(self, state: State, plan: RotorPlan | None) -> tuple[Array, str]:
        """Find the rotor speeds [Hz], shape (N_p,), at an odometry, and their key in ``SOURCES``.

        The plan is the recorded answer to it: it begins with the speeds it was made from.
        """
        after = int(np.searchsorted(self._stamps, state.stamp_ns))
        near = [k for k in (after - 1, after) if 0 <= k < len(self._stamps)]
        apart = {k: abs(int(self._stamps[k]) - state.stamp_ns) for k in near}
        if near and min(apart.values()) <= self._tolerance_ns:
            return self._xi[min(near, key=apart.__getitem__)], "recorded"
        if plan is not None:
            return plan.xi[0], "from_command"
        if len(near) == 2 and sum(apart.values()) <= stamps.nanoseconds(MAX_GAP_S):
            share = apart[near[0]] / sum(apart.values())
            xi = (1.0 - share) * self._xi[near[0]] + share * self._xi[near[1]]
            return xi, "interpolated"
        return quasi_static_rotor_speeds(state.rigid_body, self._vehicle), "estimated"

    def _decoded(self, message: Any) -> Array | None:
        n_rotors = self._vehicle.n_rotors
        try:
            return rotor_states.decode(message, n_rotors)[1]
        except MessageError:
            if sorted(message.name) == sorted(rotor_states.rotor_names(n_rotors)):
                return None
        unnamed = SimpleNamespace(header=message.header, name=[], velocity=message.velocity)
        try:
            xi: Array = rotor_states.decode(unnamed, n_rotors)[1]
        except MessageError:
            return None
        self.renamed = True
        return xi
