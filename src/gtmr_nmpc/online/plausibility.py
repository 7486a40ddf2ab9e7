# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Whether the vehicle can have moved from one odometry message to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gtmr_model import Vehicle
from gtmr_model.dynamics import ATTITUDE, POSITION, RATE, VELOCITY
from gtmr_model.vehicle import GRAVITY_M_S2
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_nmpc.config import OdometryNoise

Array = NDArray[np.float64]

NOISE_M, NOISE_M_S, NOISE_RAD, NOISE_RAD_S = 0.2, 0.5, 0.2, 0.5
"""What any estimator may add between two odometries: position, speed, angle, body rate. Ten times
the noise of a good one; a jump within them is no worse than noise."""
DEVIATIONS = 10.0
"""What an estimator of stated noise may add, in its standard deviations [-]: a difference of two
measurements in three coordinates does not exceed it once in the life of a vehicle."""
MARGIN = 2.0
"""Most acceleration that is believed, in those that all rotors at their limit give the lightest
vehicle, for what no model has: wind, walls, contact [-]."""
LASTING = 5
"""So many odometries in a row that agree with each other ..."""
LASTING_NS = 100_000_000
"""... over so long a time [ns], or for one and the same stamp, are believed in spite of what came
before: an estimator was corrected, or the vehicle was hit."""


@dataclass(frozen=True)
class Reach:
    """Most that a vehicle can accelerate."""

    linear_m_s2: float
    """In any direction."""
    angular_rad_s2: float
    """About any axis."""

    @classmethod
    def of(cls, vehicle: Vehicle) -> Reach:
        """All rotors at their limit, each to the same end."""
        wrench = np.abs(vehicle.allocation).sum(axis=1) * vehicle.max_rotor_speed_hz**2
        force_n, torque_nm = np.linalg.norm(wrench[:3]), np.linalg.norm(wrench[3:])
        return cls(
            MARGIN * (float(force_n) / vehicle.mass_kg + GRAVITY_M_S2),
            MARGIN * float(torque_nm) / min(vehicle.inertia_kg_m2),
        )


class Plausibility:
    """Sets odometry aside that jumps further than a vehicle can; believes it if it lasts."""

    def __init__(self, vehicle: Vehicle, noise: OdometryNoise | None = None) -> None:
        self._reach = Reach.of(vehicle)
        told = OdometryNoise() if noise is None else noise
        self._noise_m = max(NOISE_M, DEVIATIONS * told.position_m)
        self._noise_m_s = max(NOISE_M_S, DEVIATIONS * told.velocity_m_s)
        self._noise_rad = max(NOISE_RAD, DEVIATIONS * told.attitude_rad)
        self._noise_rad_s = max(NOISE_RAD_S, DEVIATIONS * told.rate_rad_s)
        self.reset()

    def reset(self) -> None:
        """Believe the next message: a world began again."""
        self._believed: tuple[int, Array] | None = None
        self._aside: list[tuple[int, Array]] = []

    def check(self, stamp_ns: int, x: Array) -> None:
        """Take in a state [p, eta, v, omega], shape (12,), by its stamp [ns], not behind the last.

        Raises MessageError if it can not have come of what was believed last.
        """
        jump = self._jump(self._believed, stamp_ns, x)
        if jump and not self._lasts(stamp_ns, x):
            raise MessageError(f"odometry {jump}, further than the vehicle can", "jump")
        self._believed = stamp_ns, x
        self._aside.clear()

    def _lasts(self, stamp_ns: int, x: Array) -> bool:
        if self._aside and self._jump(self._aside[-1], stamp_ns, x):
            self._aside.clear()
        self._aside.append((stamp_ns, x))
        lasted_ns = stamp_ns - self._aside[0][0]
        # A simulation that waits for its answer says the same again.
        return len(self._aside) >= LASTING and (lasted_ns >= LASTING_NS or lasted_ns == 0)

    def _jump(self, before: tuple[int, Array] | None, stamp_ns: int, x: Array) -> str:
        """Tell by how much a state is beyond what the one before allows; empty if not."""
        if before is None:
            return ""
        dt = max(0, stamp_ns - before[0]) / 1e9
        x_0, reach = before[1], self._reach
        expected = x_0[POSITION] + dt * x_0[VELOCITY]
        off_m = math.dist(x[POSITION], expected)
        off_m_s = math.dist(x[VELOCITY], x_0[VELOCITY])
        off_rad = _angle_between(x_0[ATTITUDE], x[ATTITUDE])
        off_rad_s = math.dist(x[RATE], x_0[RATE])
        turned_rad = dt * math.hypot(*x_0[RATE])
        if off_m > self._noise_m + self._noise_m_s * dt + 0.5 * reach.linear_m_s2 * dt * dt:
            return f"jumps by {off_m:.3g} m"
        if off_m_s > self._noise_m_s + reach.linear_m_s2 * dt:
            return f"jumps by {off_m_s:.3g} m/s"
        if off_rad > self._noise_rad + turned_rad + 0.5 * reach.angular_rad_s2 * dt * dt:
            return f"jumps by {off_rad:.3g} rad"
        if off_rad_s > self._noise_rad_s + reach.angular_rad_s2 * dt:
            return f"jumps by {off_rad_s:.3g} rad/s"
        return ""


def _angle_between(eta_0: Array, eta_1: Array) -> float:
    """Angle of the rotation from one attitude to another [rad]."""
    along = abs(float(_quaternion(eta_0) @ _quaternion(eta_1)))
    return 2.0 * math.acos(min(1.0, along))


def _quaternion(eta: Array) -> Array:
    """Turn roll, pitch, yaw [rad] into a unit quaternion, of either sign."""
    c_r, c_p, c_y = np.cos(0.5 * eta)
    s_r, s_p, s_y = np.sin(0.5 * eta)
    return np.array(
        [
            s_r * c_p * c_y - c_r * s_p * s_y,
            c_r * s_p * c_y + s_r * c_p * s_y,
            c_r * c_p * s_y - s_r * s_p * c_y,
            c_r * c_p * c_y + s_r * s_p * s_y,
        ]
    )
