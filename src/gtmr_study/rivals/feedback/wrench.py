# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""From a wrench on the body to rotor accelerations, and the attitude that a force needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gtmr_model import Vehicle
from gtmr_model.vehicle import GRAVITY_M_S2

Array = NDArray[np.float64]

ROTOR_LOOP_S = 0.05
"""Time constant with which rotors are brought to the speeds of a wrench [s]: two sampling times,
the fastest that leaves a discrete loop well damped."""


def rotation_of(eta: Array) -> Array:
    """Rotation from body to world of roll, pitch and yaw [rad], shape (3, 3), as in the model."""
    (a, b, c), (d, e, f) = np.cos(eta), np.sin(eta)
    return np.array(
        [
            [c * b, c * e * d - f * a, c * e * a + f * d],
            [f * b, f * e * d + c * a, f * e * a - c * d],
            [-e, b * d, b * a],
        ]
    )


def attitude_error(actual: Array, wanted: Array) -> Array:
    """Attitude error on SO(3), body frame [rad], shape (3,) (Lee et al., CDC 2010, eq. 10)."""
    skew = 0.5 * (wanted.T @ actual - actual.T @ wanted)
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors, shape (3,): NumPy's own takes ten times as long for them."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


class Wrench:
    """Makes a vehicle's rotors produce a wrench."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.allocation = vehicle.allocation
        """Wrench per squared rotor speed, body frame, shape (6, N_p)."""
        self._inverse = np.linalg.pinv(self.allocation)
        self._hover = vehicle.hover_rotor_speeds_hz**2
        self._low = vehicle.min_rotor_speed_hz**2
        self._high = vehicle.max_rotor_speed_hz**2
        self._is_fully_actuated = np.linalg.matrix_rank(self._inverse) == 6
        self.force_is_limited = self.torque_is_limited = False
        """Whether the last wrench had more force, or torque, than the rotors can give."""

    def attitude_for(self, force: Array, yaw: float) -> Array:
        """Rotation in which the vehicle can give a force, world frame [N], facing ``yaw`` [rad].

        Level where the rotors push into any direction; tilted along the force where they cannot.
        """
        if self._is_fully_actuated:
            return rotation_of(np.array([0.0, 0.0, yaw]))
        up = force / np.linalg.norm(force)
        left = cross(up, np.array([np.cos(yaw), np.sin(yaw), 0.0]))
        left /= np.linalg.norm(left)
        return np.column_stack((cross(left, up), left, up))

    def of(self, speeds_hz: Array) -> Array:
        """Nominal wrench of rotor speeds [Hz], body frame [N, N m], shape (6,)."""
        return np.asarray(self.allocation @ (speeds_hz * speeds_hz))

    def rotor_accelerations(self, wrench: Array, speeds_hz: Array) -> Array:
        """Bring rotors from their speeds [Hz] to those of a wrench; gives [Hz/s], shape (N_p,).

        Of a wrench beyond the rotors' limits the torque goes first, and the force is scaled
        towards that of hover: a vehicle that is asked for too much must not turn over.
        """
        force, torque = wrench.copy(), wrench.copy()
        force[3:] = torque[:3] = 0.0
        turning = self._inverse @ torque
        pushing = self._inverse @ force - self._hover
        share = self._share(self._hover, turning)
        squared = self._hover + share * turning
        share_of_force = self._share(squared, pushing)
        self.torque_is_limited, self.force_is_limited = share < 1.0, share_of_force < 1.0
        squared = squared + share_of_force * pushing
        return np.asarray((np.sqrt(np.maximum(squared, 0.0)) - speeds_hz) / ROTOR_LOOP_S)

    def _share(self, squared: Array, change: Array) -> float:
        """How much of a change keeps squared rotor speeds within limits, 0 to 1."""
        room = np.where(change > 0.0, self._high - squared, squared - self._low)
        room = np.maximum(room, 0.0)
        short = np.abs(change) > room
        return float(np.min(room[short] / np.abs(change[short]), initial=1.0))

    def hover_force(self) -> Array:
        """Force that holds the nominal vehicle, world frame [N], shape (3,)."""
        return np.array([0.0, 0.0, self._vehicle.mass_kg * GRAVITY_M_S2])
