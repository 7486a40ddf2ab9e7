# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Estimates the force and torque beyond the nominal model: a Kalman filter with constant gains.

The rotors' speeds are measured, and what they do not explain of the motion is put down to theta =
[b, g, tau]: a persistent force b and a gust force g, world frame [N], and a torque tau, body frame
[N m]. Saturated rotors and lost commands therefore wind nothing up.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model.dynamics import (
    ATTITUDE,
    POSITION,
    RATE,
    ROTORS,
    VELOCITY,
    discrete_step,
    one_at_a_time,
    symbols,
)
from gtmr_model.uncertainty import N_ZETA
from gtmr_model.vehicle import GRAVITY_M_S2, Vehicle
from gtmr_nmpc.config import ControllerConfig

Array = NDArray[np.float64]

N_THETA = 9
"""Length of theta."""
BIAS, GUST, TORQUE = slice(0, 3), slice(3, 6), slice(6, 9)
"""b, g and tau in theta."""
BOUND_TILT_RAD = 0.2
"""Tilt up to which wrong mass and thrust may make a horizontal force, for the bounds [rad]."""
BOUND_IMBALANCE = 0.1
"""Share of its thrust by which one rotor may differ from the others, for the bounds [-]; it comes
on top of that of the uncertainty set."""
BOUND_FACTOR = 2.0
"""How far beyond what the uncertainty set can explain an estimate may go, as on the ground."""


class Estimate(NamedTuple):
    """What is believed after a measurement."""

    x: Array
    """State, shape (12 + N_p,)."""
    theta: Array
    """Disturbances [N, N, N m], shape (9,)."""


class Observer(Protocol):
    """Estimates state and disturbances from measurements, one every T_s."""

    def reconfigure(self, config: ControllerConfig) -> None:
        """Take over other noise, disturbances or bounds."""
        ...

    def reset(self) -> None:
        """Forget everything: the next measurement is taken as it is, without disturbances."""
        ...

    def update(self, x: Array, dt_s: float) -> Estimate:
        """Take in a measured state, shape (12 + N_p,), so long after the one before [s]."""
        ...

    def ahead(self, x: Array, xi: Array, dt_s: float) -> Array:
        """Predict a state by dt_s while the rotors go to speeds xi [Hz], shape (N_p,)."""
        ...


@dataclass(frozen=True)
class Gains:
    """Constant gains of the filter, in the units of state per unit of innovation."""

    translation: Array
    """Of [p, v, b, g] by [p, v], the same on each axis of the world, shape (4, 2)."""
    rotation: Array
    """Of [eta, omega, tau / J] by [eta, omega], the same on each axis, shape (3, 2)."""


def gust_decay(config: ControllerConfig) -> float:
    """How much of the gust force is left after T_s: exp(-T_s / tau)."""
    return math.exp(-config.sampling_time_s / config.offset_free.disturbance.gust_time_s)


@lru_cache(maxsize=32)
def gains(config: ControllerConfig) -> Gains:
    """Solve the two Riccati equations of the filter for the stated noise and disturbances."""
    dt, mass = config.sampling_time_s, config.vehicle.mass_kg
    noise, disturbance = config.offset_free.noise, config.offset_free.disturbance
    decay = gust_decay(config)
    push = np.array([0.5 * dt * dt, dt]) / mass
    a = np.eye(4)
    a[0, 1] = dt
    a[:2, 2] = a[:2, 3] = push
    a[3, 3] = decay
    walk = disturbance.bias_n_per_sqrt_s**2 * dt
    gust = disturbance.gust_n**2 * (1.0 - decay * decay)
    measured = np.diag([noise.position_m, noise.velocity_m_s]) ** 2
    translation = _filter_gain(a, np.diag([0.0, 0.0, walk, gust]), measured)

    a = np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    inertia = float(np.mean(config.vehicle.inertia_kg_m2))
    walk = (disturbance.torque_nm_per_sqrt_s / inertia) ** 2 * dt
    measured = np.diag([noise.attitude_rad, noise.rate_rad_s]) ** 2
    return Gains(translation, _filter_gain(a, np.diag([0.0, 0.0, walk]), measured))


def _filter_gain(a: Array, process: Array, measured: Array) -> Array:
    """Gain by which an innovation of the first two states corrects all of them."""
    # Imported here, as it takes longer than the rest of the controller.
    from scipy.linalg import solve_discrete_are

    c = np.eye(2, len(a))
    p = solve_discrete_are(a.T, c.T, process, measured)
    return _rounded(np.linalg.solve(c @ p @ c.T + measured, c @ p).T)


def _rounded(gain: Array) -> Array:
    """Keep 12 digits: the rest depends on how many threads solve an equation."""
    unit = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(gain), 1e-30))) - 11.0)
    return np.asarray(np.round(gain / unit) * unit)


def bounds(config: ControllerConfig) -> Array:
    """Bounds on theta [N, N, N m], shape (9,): twice what the uncertainty set can explain."""
    box, vehicle = config.uncertainty, config.vehicle
    weight_n = vehicle.mass_kg * GRAVITY_M_S2
    along = np.array([BOUND_TILT_RAD, BOUND_TILT_RAD, 1.0])
    force = np.array(box.wind_bias_n) + along * weight_n * (box.mass + box.thrust)
    arm_m = float(np.linalg.norm(np.array([r.position_m for r in vehicle.rotors]), axis=1).max())
    # Half of the rotors, on one side, too strong: a third of the arm from the centre, or less.
    torque = np.full(3, (box.thrust + BOUND_IMBALANCE) * weight_n * arm_m / 3.0)
    return BOUND_FACTOR * np.concatenate([force, np.full(3, box.gust_n), torque])


@lru_cache(maxsize=64)
@one_at_a_time
def motion(vehicle: Vehicle) -> ca.Function:
    """One RK4 step of any length with disturbances held: (x, u, force, torque, dt) -> x_next."""
    x, u, _, force = symbols(vehicle)
    torque, dt = ca.SX.sym("torque", 3), ca.SX.sym("dt")
    zeta = ca.DM.zeros(N_ZETA)
    x_next = discrete_step(x, u, zeta, force, vehicle, dt, torque)
    names = ["x", "u", "force", "torque", "dt"]
    return ca.Function("motion", [x, u, force, torque, dt], [x_next], names, ["x_next"])


class InterpretedObserver:
    """An `Observer` in NumPy."""

    def __init__(self, config: ControllerConfig) -> None:
        self._motion = motion(config.vehicle)
        self.reconfigure(config)
        self.reset()

    def reconfigure(self, config: ControllerConfig) -> None:
        """See `Observer.reconfigure`."""
        self._config = config
        self._gains = gains(config)
        self._bounds = bounds(config)

    def reset(self) -> None:
        """See `Observer.reset`."""
        self._x: Array | None = None
        self._theta = np.zeros(N_THETA)

    def update(self, x: Array, dt_s: float) -> Estimate:
        """See `Observer.update`."""
        config = self._config
        steps = max(1, math.ceil(dt_s / config.sampling_time_s - 1e-6)) if dt_s > 0.0 else 0
        if self._x is None or not 1 <= steps <= config.horizon:
            return self._begin(x)
        decay = gust_decay(config) ** (dt_s / (steps * config.sampling_time_s))
        for k in range(steps):
            xi = self._x[ROTORS] + (x[ROTORS] - self._x[ROTORS]) / (steps - k)
            self._x = self.ahead(self._x, xi, dt_s / steps)
            self._theta[GUST] *= decay
        self._correct(self._x, x)
        if not math.isfinite(sum(self._x.tolist())):
            # What came before was out of this world.
            return self._begin(x)
        return Estimate(self._x.copy(), self._theta.copy())

    def _begin(self, x: Array) -> Estimate:
        self.reset()
        self._x = x.copy()
        return Estimate(self._x.copy(), self._theta.copy())

    def ahead(self, x: Array, xi: Array, dt_s: float) -> Array:
        """See `Observer.ahead`."""
        u = (xi - x[ROTORS]) / dt_s
        force = self._theta[BIAS] + self._theta[GUST]
        moved = np.asarray(self._motion(x, u, force, self._theta[TORQUE], dt_s)).ravel()
        moved[ROTORS] = xi
        return moved

    def _correct(self, x: Array, measured: Array) -> None:
        translation, rotation = self._gains.translation, self._gains.rotation
        far, fast = (measured - x)[POSITION], (measured - x)[VELOCITY]
        turned, turning = (measured - x)[ATTITUDE], (measured - x)[RATE]
        turned -= math.tau * np.round(turned / math.tau)
        inertia = np.array(self._config.vehicle.inertia_kg_m2)
        parts = [by[0] * far + by[1] * fast for by in translation]
        turns = [by[0] * turned + by[1] * turning for by in rotation]
        x[POSITION] += parts[0]
        x[VELOCITY] += parts[1]
        x[ATTITUDE] += turns[0]
        x[RATE] += turns[1]
        self._theta += np.concatenate([parts[2], parts[3], inertia * turns[2]])
        np.clip(self._theta, -self._bounds, self._bounds, out=self._theta)
