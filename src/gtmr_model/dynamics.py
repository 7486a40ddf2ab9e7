# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Equations of motion of the GTMR, eq. (3): written once in symbols, callable with NumPy."""

from collections.abc import Callable
from functools import lru_cache, wraps
from threading import RLock
from typing import Any, ParamSpec, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_model.uncertainty import N_ZETA
from gtmr_model.vehicle import GRAVITY_M_S2, Vehicle

POSITION = slice(0, 3)
"""p in x: world ENU [m]."""
ATTITUDE = slice(3, 6)
"""eta in x: roll, pitch, yaw of body FLU in world ENU [rad]."""
VELOCITY = slice(6, 9)
"""v in x: world ENU [m/s]."""
RATE = slice(9, 12)
"""omega in x: body FLU [rad/s]."""
ROTORS = slice(12, None)
"""xi in x: rotor speeds [Hz]."""
PITCH, YAW = 4, 5
"""Their index in x."""

P = ParamSpec("P")
T = TypeVar("T")
MAKING_SYMBOLS = RLock()
"""Held by the thread that makes CasADi expressions, see `one_at_a_time`."""


def one_at_a_time(make: Callable[P, T]) -> Callable[P, T]:
    """Let one thread at a time run functions that make CasADi expressions.

    Expressions share constants that are not counted atomically: threads that make some, or drop
    some, at once crash the process. Evaluating what was made needs no lock.
    """

    @wraps(make)
    def locked(*args: P.args, **kwargs: P.kwargs) -> T:
        with MAKING_SYMBOLS:
            return make(*args, **kwargs)

    return locked


def rotation(eta: Any) -> Any:
    """Rotation matrix Rz(yaw) Ry(pitch) Rx(roll) from body to world, symbolic; eta in [rad]."""
    c, s = ca.cos(eta), ca.sin(eta)
    return ca.vertcat(
        ca.horzcat(
            c[2] * c[1], c[2] * s[1] * s[0] - s[2] * c[0], c[2] * s[1] * c[0] + s[2] * s[0]
        ),
        ca.horzcat(
            s[2] * c[1], s[2] * s[1] * s[0] + c[2] * c[0], s[2] * s[1] * c[0] - c[2] * s[0]
        ),
        ca.horzcat(-s[1], c[1] * s[0], c[1] * c[0]),
    )


def euler_rate(eta: Any, omega: Any) -> Any:
    """Rate of roll, pitch and yaw [rad/s] for a body rate [rad/s], T(eta) omega, symbolic.

    The pitch stays away from +-90 deg.
    """
    sin_roll, cos_roll = ca.sin(eta[0]), ca.cos(eta[0])
    yaw_rate = (sin_roll * omega[1] + cos_roll * omega[2]) / ca.cos(eta[1])
    return ca.vertcat(
        omega[0] + ca.sin(eta[1]) * yaw_rate,
        cos_roll * omega[1] - sin_roll * omega[2],
        yaw_rate,
    )


def state_derivative(
    x: Any, u: Any, zeta: Any, w_g: Any, vehicle: Vehicle, torque: Any = 0.0
) -> Any:
    """Evaluate f(x, u, zeta) + G_w w_g, eq. (3), on CasADi symbols; as `dynamics` on numbers.

    A torque on the body beyond eq. (3) is in the body frame [N m], shape (3,).
    """
    eta, v, omega, xi = x[ATTITUDE], x[VELOCITY], x[RATE], x[ROTORS]
    mass = (1.0 + zeta[0]) * vehicle.mass_kg
    inertia = (1.0 + zeta[1:4]) * ca.DM(vehicle.inertia_kg_m2)
    wrench = (1.0 + zeta[4]) * (ca.DM(vehicle.allocation) @ (xi * xi))
    drag = (1.0 + zeta[5]) * vehicle.drag_n_s_per_m
    wind_bias = zeta[6:9]

    force = rotation(eta) @ wrench[:3] - drag * v + wind_bias + w_g
    gravity = ca.DM([0.0, 0.0, GRAVITY_M_S2])
    angular_acceleration = (wrench[3:] + torque - ca.cross(omega, inertia * omega)) / inertia
    return ca.vertcat(v, euler_rate(eta, omega), force / mass - gravity, angular_acceleration, u)


def rk4_step(x: Any, step_s: Any, derivative: Any) -> Any:
    """One step [s] of the classical fourth-order Runge-Kutta scheme, inputs held over it.

    The derivative maps a state, symbolic or of numbers, to its time derivative.
    """
    k1 = derivative(x)
    k2 = derivative(x + 0.5 * step_s * k1)
    k3 = derivative(x + 0.5 * step_s * k2)
    k4 = derivative(x + step_s * k3)
    return x + step_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def discrete_step(
    x: Any, u: Any, zeta: Any, w_g: Any, vehicle: Vehicle, step_s: Any, torque: Any = 0.0
) -> Any:
    """Discretise eq. (3), with the arguments of `state_derivative`, on CasADi symbols.

    One RK4 step [s] with input, zeta, gust and torque held.
    """
    return rk4_step(x, step_s, lambda x: state_derivative(x, u, zeta, w_g, vehicle, torque))


def symbols(vehicle: Vehicle) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Make fresh symbols x (12 + N_p), u (N_p), zeta (9), w_g (3) for a vehicle."""
    return (
        ca.SX.sym("x", vehicle.n_x),
        ca.SX.sym("u", vehicle.n_rotors),
        ca.SX.sym("zeta", N_ZETA),
        ca.SX.sym("w_g", 3),
    )


@lru_cache(maxsize=8)
@one_at_a_time
def _dynamics_function(vehicle: Vehicle) -> ca.Function:
    x, u, zeta, w_g = symbols(vehicle)
    return ca.Function("dynamics", [x, u, zeta, w_g], [state_derivative(x, u, zeta, w_g, vehicle)])


def dynamics(
    x: ArrayLike, u: ArrayLike, zeta: ArrayLike, w_g: ArrayLike, vehicle: Vehicle
) -> NDArray[np.float64]:
    """Evaluate f(x, u, zeta) + G_w w_g, eq. (3), on numbers: the time derivative of x.

    Parameters
    ----------
    x : array_like, shape (12 + N_p,)
        State [p, eta, v, omega, xi]: m, rad, m/s, rad/s, Hz; world ENU, omega in body FLU.
    u : array_like, shape (N_p,)
        Rotor accelerations [Hz/s].
    zeta : array_like, shape (9,)
        Structured uncertainty, eq. (4): relative, wind bias in N.
    w_g : array_like, shape (3,)
        Gust force, world frame [N].
    vehicle : Vehicle
        Nominal parameters.

    Raises
    ------
    ValueError
        If an argument has the wrong length.
    """
    sizes = {"x": vehicle.n_x, "u": vehicle.n_rotors, "zeta": N_ZETA, "w_g": 3}
    arrays = []
    for (name, size), value in zip(sizes.items(), (x, u, zeta, w_g), strict=True):
        array = np.asarray(value, dtype=float)
        if array.shape != (size,):
            raise ValueError(f"{name} has shape {array.shape}, expected ({size},)")
        arrays.append(array)
    return np.asarray(_dynamics_function(vehicle)(*arrays)).ravel()
