# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The reference: a path in time whose position and yaw are formulas, eq. (2)."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Self

from gtmr_model.dynamics import POSITION, RATE, ROTORS, VELOCITY, YAW, one_at_a_time
from gtmr_model.tower import Tower
from gtmr_model.vehicle import Vehicle
from gtmr_model.yaml_model import OneOfKinds


@dataclass(frozen=True)
class Reference:
    """A path at n instants, world frame."""

    position: NDArray[np.float64]
    """[m], shape (n, 3)."""
    velocity: NDArray[np.float64]
    """[m/s], shape (n, 3)."""
    acceleration: NDArray[np.float64]
    """[m/s^2], shape (n, 3)."""
    yaw: NDArray[np.float64]
    """Grows without wrapping [rad], shape (n,)."""
    yaw_rate: NDArray[np.float64]
    """[rad/s], shape (n,)."""


class ReferencePath(OneOfKinds):
    """A path in time: its own numbers, and two formulas, which hold for numbers and symbols.

    Velocity, acceleration and yaw rate are their derivatives. A subclass with a ``kind`` of its
    own can be chosen by that name. Every number has a default; fields that are not one float each
    are compiled in.
    """

    kind: str = "helix"
    """Which path."""

    def position(self, t: Any, tower: Tower) -> Any:
        """Position at time t [s], world frame [m], shape (3,); of CasADi's functions."""
        raise NotImplementedError

    def yaw(self, t: Any, tower: Tower) -> Any:
        """Yaw at time t [s] [rad]; never wraps."""
        raise NotImplementedError

    def at(self, time_s: ArrayLike, tower: Tower) -> Reference:
        """Sample the path.

        Parameters
        ----------
        time_s : array_like, shape (n,)
            Instants [s].
        tower : Tower
            What the path goes around.
        """
        t = np.atleast_1d(np.asarray(time_s, dtype=float))
        values = reference_function(self.form)(t[None, :], [*tower.numbers, *self.numbers])
        position, velocity, acceleration, yaw, yaw_rate = (np.asarray(v).T.copy() for v in values)
        return Reference(position, velocity, acceleration, yaw[:, 0], yaw_rate[:, 0])

    def clearance(self, time_s: ArrayLike, tower: Tower) -> NDArray[np.float64]:
        """Its own distance to the tower's surface at instants [s], d_ref of eq. (2) [m]."""
        return np.asarray(tower.clearance(self.at(time_s, tower).position))

    def clearance_text(self, duration_s: float, tower: Tower) -> str:
        """Say its clearance during a flight of that duration [s]: one, or least to most [m]."""
        clearance = self.clearance(np.linspace(0.0, duration_s, 600), tower)
        low, high = f"{clearance.min():.6g}", f"{clearance.max():.6g}"
        return f"{low} m" if low == high else f"{low} to {high} m"

    @property
    def form(self) -> Self:
        """The same with all numbers at their defaults: what its compiled formulas depend on."""
        fields = type(self).model_fields.items()
        rest = {name: getattr(self, name) for name, info in fields if info.annotation is not float}
        made: Any = type(self).model_construct(**rest)
        return made

    def facing(self, time_s: float, tower: Tower) -> float:
        """Yaw at one instant [s] [rad], at the cost of arithmetic alone."""
        return float(self.yaw(time_s, tower))

    def initial_state(self, tower: Tower, vehicle: Vehicle) -> NDArray[np.float64]:
        """State on the path at t = 0, level and with hover rotor speeds, shape (12 + N_p,)."""
        start = self.at(0.0, tower)
        x = np.zeros(vehicle.n_x)
        x[POSITION] = start.position[0]
        x[YAW] = start.yaw[0]
        x[VELOCITY] = start.velocity[0]
        x[RATE] = [0.0, 0.0, start.yaw_rate[0]]
        x[ROTORS] = vehicle.hover_rotor_speeds_hz
        return x


@cache
@one_at_a_time
def reference_function(form: ReferencePath) -> ca.Function:
    """Differentiate a form of path, for any values of its numbers.

    Returns
    -------
    casadi.Function
        (t, [R, d_min, numbers of the path]) -> position, velocity, acceleration, yaw, yaw rate.
    """
    path, numbers = form.symbolic()
    tower, sizes = Tower().symbolic()
    t = ca.SX.sym("t")
    position, yaw = path.position(t, tower), path.yaw(t, tower)
    velocity = ca.jacobian(position, t)
    results = [position, velocity, ca.jacobian(velocity, t), yaw, ca.jacobian(yaw, t)]
    return ca.Function(
        "reference", [t, ca.vertcat(sizes, numbers)], [ca.densify(r) for r in results]
    )
