# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The guard's law in NumPy, the same steps as in C: its oracle, and the fallback."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gtmr_guard.config import Array, Parameters
from gtmr_model.vehicle import GRAVITY_M_S2

GRAVITY = np.array([0.0, 0.0, GRAVITY_M_S2])
MAX_DISTURBANCE_M_S2 = 4.0
"""Bound on the estimated disturbing acceleration [m/s^2]."""
MAX_ANGULAR_DISTURBANCE_RAD_S2 = 10.0
"""Bound on the estimated disturbing angular acceleration [rad/s^2]."""
MAX_V_M_S, MAX_OMEGA_RAD_S = 30.0, 20.0
"""Bounds on the estimates of velocity and body rate; beyond, none is recovered [m/s], [rad/s]."""
JUMP_M, JUMP_RAD = 0.5, 1.0
"""Innovations that no vehicle can make between two ticks: the estimate is moved, not corrected."""
NONE, UNUSABLE, ENDED, TILT, SPEED, ZONE = range(6)
"""Indices of `CAUSES`."""
UPSIDE_DOWN = 0.5
"""Cosine of the angle between thrust axis and wanted force below which it only turns, and less
than whose negative is upside down [-]."""
MAX_TURN_RAD_S = 3.0
"""Most body rate that it asks for [rad/s]."""
ROUNDING_HZ2 = 1e-6
"""Change of a squared rotor speed that counts as zero [Hz^2]."""
MIN_LIFT = 0.3
"""Least part of the weight that the wanted force lifts [-]."""


class ReferenceGuard:
    """A guard's memory and its step; see `Guard`."""

    def __init__(self, parameters: Parameters) -> None:
        self.reconfigure(parameters)
        self.reset()

    def reconfigure(self, parameters: Parameters) -> None:
        """Go on with other numbers."""
        self._is = parameters

    def reset(self) -> None:
        """Forget the flight."""
        self._warm_s = -1.0
        self.cause = NONE
        self._quiet_s = self._zone_s = 0.0
        self._braking = False
        self._target = np.zeros(3)
        self.v = np.zeros(3)
        self.omega = np.zeros(3)
        self.d = np.zeros(3)
        self.d_omega = np.zeros(3)

    def step(
        self, dt_s: float, x: Array, u_due: Array, overdue_s: float, age_s: float
    ) -> tuple[int, Array]:
        """See `Guard.step`; gives the cause by its index in `CAUSES`, too."""
        self._estimate(dt_s, x[0:3], x[3:6], x[12:])
        self._decide(dt_s, u_due, overdue_s, age_s)
        if self.cause == NONE:
            flown = overdue_s < 0.0 and self._is_usable(u_due)
            return NONE, u_due if flown else np.zeros(len(u_due))
        return self.cause, self._retreat()

    def _estimate(self, dt: float, p: Array, eta: Array, xi: Array) -> None:
        """Filter measurement and model; three poles each for position and for attitude."""
        k = self._is
        seen = bool(np.isfinite(p).all() and np.isfinite(eta).all() and np.isfinite(xi).all())
        first = self._warm_s < 0.0
        if first and not seen:
            return
        if seen:
            self._xi = xi.copy()
        squared = self._xi * self._xi
        wrench = k.allocation @ squared
        if first:
            self._warm_s = 0.0
            self._p, self.R = p.copy(), rotation(eta)
            self._thrust, self._torque = self.R @ wrench[:3] / k.mass_kg, wrench[3:]
            return
        self._warm_s += dt

        inertia = k.inertia_kg_m2
        torque = 0.5 * (self._torque + wrench[3:])
        spin = (torque - np.cross(self.omega, inertia * self.omega)) / inertia + self.d_omega
        R_before = self.R @ rotation_by(dt * (self.omega + 0.5 * dt * spin))
        omega = self.omega + dt * spin
        alpha, beta, gamma = gains(k.attitude_filter_rad_s, dt, self._warm_s)
        self.R = R_before
        if seen:
            R = rotation(eta)
            e = rotation_vector(R_before.T @ R)
            if math.sqrt(e @ e) > JUMP_RAD:
                self.R = R
            else:
                self.R = R @ rotation_by((alpha - 1.0) * e)
                omega = omega + beta / dt * e
                self.d_omega = limited(
                    self.d_omega + gamma / (dt * dt) * e, MAX_ANGULAR_DISTURBANCE_RAD_S2
                )
        self.omega, self._torque = limited(omega, MAX_OMEGA_RAD_S), wrench[3:]

        thrust = self.R @ wrench[:3] / k.mass_kg
        acceleration = 0.5 * (self._thrust + thrust) - GRAVITY + self.d
        p_before = self._p + dt * (self.v + 0.5 * dt * acceleration)
        v = self.v + dt * acceleration
        alpha, beta, gamma = gains(k.position_filter_rad_s, dt, self._warm_s)
        self._p = p_before
        if seen:
            e = p - p_before
            if math.sqrt(e @ e) > JUMP_M:
                self._p = p.copy()
            else:
                self._p = p_before + alpha * e
                v = v + beta / dt * e
                self.d = limited(self.d + gamma / (dt * dt) * e, MAX_DISTURBANCE_M_S2)
        self.v, self._thrust = limited(v, MAX_V_M_S), thrust

    def _is_usable(self, u_due: Array) -> bool:
        """Whether a command can be sent to rotors; NaN cannot."""
        return bool((np.abs(u_due) <= self._is.max_command_hz_s).all())

    def _decide(self, dt: float, u_due: Array, overdue_s: float, age_s: float) -> None:
        k = self._is
        if self._warm_s < 0.0:
            return
        rho, outward = self._radial()
        clearance = rho - k.tower_radius_m
        v_r = outward @ self.v
        speed, rate = math.sqrt(self.v @ self.v), math.sqrt(self.omega @ self.omega)

        lingers = clearance < k.zone_m and v_r < k.stopped_m_s
        self._zone_s = self._zone_s + dt if lingers else 0.0
        # Where it would come to rest if it began to brake now, and its push inward went on until
        # that takes effect.
        inward = min(float(outward @ self._thrust + outward @ self.d), 0.0)
        v_then = v_r + k.reaction_s * inward
        stop = clearance + 0.5 * k.reaction_s * (v_r + v_then)
        stop -= v_then * v_then / (2.0 * k.brake_m_s2)
        unstoppable = v_r < 0.0 and stop < k.zone_m

        cause = NONE
        if not self._is_usable(u_due):
            cause = UNUSABLE
        elif overdue_s > k.patience_s or age_s > k.max_plan_age_s:
            cause = ENDED
        elif self.R[2, 2] < k.min_tilt_cosine:
            cause = TILT
        elif speed > k.max_speed_m_s or rate > k.max_rate_rad_s:
            cause = SPEED
        elif unstoppable or self._zone_s > k.zone_time_s:
            cause = ZONE

        if cause != NONE:
            if self.cause == NONE:
                self._braking = True
            self.cause, self._quiet_s = cause, 0.0
        elif self.cause != NONE:
            well = (
                overdue_s < 0.0
                and age_s <= k.fresh_s
                and self.R[2, 2] > 0.5 * (1.0 + k.min_tilt_cosine)
                and speed < 0.5 * k.max_speed_m_s
                and rate < 0.5 * k.max_rate_rad_s
                and clearance > k.min_clearance_m
            )
            self._quiet_s = self._quiet_s + dt if well else 0.0
            if self._quiet_s >= k.handback_s:
                self.cause = NONE

    def _radial(self) -> tuple[float, Array]:
        rho = math.sqrt(self._p[0] * self._p[0] + self._p[1] * self._p[1])
        if rho < 1e-6:
            return rho, np.array([1.0, 0.0, 0.0])
        return rho, np.array([self._p[0] / rho, self._p[1] / rho, 0.0])

    def _retreat(self) -> Array:
        """Brake, move away from the tower, hover."""
        k = self._is
        rho, outward = self._radial()
        along = self.v - (outward @ self.v) * outward
        if self._braking:
            self._target = max(rho, k.tower_radius_m + k.retreat_clearance_m) * outward
            self._target[2] = self._p[2]
            self._braking = math.sqrt(along @ along) > k.stopped_m_s
        v_wanted = limited(k.position_gain * (self._target - self._p), k.retreat_speed_m_s)
        a = k.velocity_gain * (v_wanted - self.v)
        a[:2] = limited(a[:2], k.max_acceleration_m_s2)
        a[2] = min(max(a[2], -k.max_acceleration_m_s2), GRAVITY_M_S2)
        force = k.mass_kg * (a + GRAVITY - self.d)
        force[2] = max(force[2], MIN_LIFT * k.mass_kg * GRAVITY_M_S2)

        f = self.R.T @ force
        upright = f[2] / math.sqrt(f @ f)
        # Turn the thrust axis, body e3, into the wanted force; heading is left free. Upside
        # down, turn by way of outward, so that thrust does not sweep across the tower.
        aim = self.R.T @ outward if upright < -UPSIDE_DOWN else f
        sine = math.sqrt(aim[0] * aim[0] + aim[1] * aim[1])
        axis = np.array([1.0, 0.0, 0.0])
        if sine > 1e-9:
            axis = np.array([-aim[1] / sine, aim[0] / sine, 0.0])
        turn = min(k.attitude_gain * math.atan2(sine, aim[2]), MAX_TURN_RAD_S) * axis
        inertia = k.inertia_kg_m2
        spin = k.rate_gain * (turn - self.omega) - self.d_omega
        torque = inertia * spin + np.cross(self.omega, inertia * self.omega)

        low, high = k.min_rotor_speed_hz**2, k.max_rotor_speed_hz**2
        squared = k.inverse[:, 2] * min(max(f[2], k.min_thrust_n), k.max_thrust_n)
        # Roll and pitch come before sideways force, and yaw last, as its torque is expensive.
        squared = within(squared, k.inverse[:, 3:5] @ torque[:2], low, high)
        if upright > UPSIDE_DOWN:
            squared = within(squared, k.inverse[:, :2] @ f[:2], low, high)
        squared = within(squared, k.inverse[:, 5] * torque[2], low, high)
        xi = np.sqrt(np.clip(squared, low, high))
        limit = k.max_rotor_acceleration_hz_s
        return np.clip(k.rotor_gain * (xi - self._xi), -limit, limit)


def gains(rate: float, dt: float, warm_s: float) -> tuple[float, float, float]:
    """Gains of a filter of position, speed and acceleration with three equal poles [rad/s].

    At first the poles are faster, so that it starts without a guess of the speed.
    """
    theta, slow = math.exp(-dt * max(rate, 3.0 / warm_s)), math.exp(-dt * rate)
    alpha = 1.0 - theta * theta * theta
    beta = 1.5 * (1.0 - theta) * (1.0 - theta) * (1.0 + theta)
    gamma = (1.0 - slow) * (1.0 - slow) * (1.0 - slow)
    return alpha, beta, gamma


def limited(a: Array, bound: float) -> Array:
    """Shorten a vector to a norm."""
    norm = math.sqrt(a @ a)
    return a * (bound / norm) if norm > bound else a


def within(base: Array, more: Array, low: float, high: float) -> Array:
    """Add as much of a further request as the bounds allow."""
    share = 1.0
    for b, m in zip(base, more, strict=True):
        if m > ROUNDING_HZ2 and b + share * m > high:
            share = max(0.0, (high - b) / m)
        elif m < -ROUNDING_HZ2 and b + share * m < low:
            share = max(0.0, (low - b) / m)
    return base + share * more


def rotation(eta: Array) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll), body to world; shape (3, 3)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(eta), np.cos(eta)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotation_by(a: Array) -> Array:
    """Rotation by a vector [rad], Rodrigues; shape (3, 3)."""
    angle2 = a @ a
    angle = math.sqrt(angle2)
    s = math.sin(angle) / angle if angle > 1e-6 else 1.0
    c = (1.0 - math.cos(angle)) / angle2 if angle > 1e-6 else 0.5
    K = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
    return np.eye(3) + s * K + c * (K @ K)


def rotation_vector(R: Any) -> Array:
    """Inverse of `rotation_by` for less than half a turn [rad], shape (3,)."""
    a = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = math.sqrt(a @ a)
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    return a * (math.atan2(sine, cosine) / sine) if sine > 1e-9 else a
