# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The true vehicle: eq. (3) with the true zeta, a fine integration step and actuator limits."""

import ctypes
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_codegen.c_source import c_function
from gtmr_codegen.library import CompileError, load_library, warn_interpreted
from gtmr_model.dynamics import ROTORS, rk4_step, state_derivative, symbols
from gtmr_model.tower import Tower
from gtmr_model.uncertainty import N_ZETA
from gtmr_model.vehicle import Vehicle

Array = NDArray[np.float64]
TOWER = Tower()
Integrator = Callable[[Array, int], None]
"""Takes a plant's memory, x, u, zeta and w_g in one row, and moves x on by a number of steps."""

Effect = Callable[[Any, Any, Vehicle, Tower], tuple[Any, Any]]
"""Maps CasADi symbols of x, shape (12 + N_p,), and zeta, shape (9,), with the nominal vehicle and
the tower, to an extra force, world frame [N], and torque, body frame [N m], each of shape (3,).
It is compiled into the plant, and evaluated within every step of the integration."""

ADVANCE = """
#include <string.h>

/* memory: x, then what is held. */
void plant_advance(double *memory, int steps)
{
    double next[N_X];
    for (; steps > 0; --steps) {
        plant_step(memory, next);
        memcpy(memory, next, sizeof next);
    }
}
"""


class Plant:
    """A vehicle in flight, by its nominal parameters and what differs from them.

    Parameters
    ----------
    zeta : array_like, shape (9,)
        The true mismatch and wind bias, eq. (4).
    x : array_like, shape (12 + N_p,)
        State to start from.
    step_s : float
        Integration step [s].
    tower : Tower
        What effects may depend on.
    effects : tuple of Effect
        Forces and torques beyond eq. (3); they add up.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        zeta: ArrayLike,
        x: ArrayLike,
        step_s: float,
        tower: Tower = TOWER,
        effects: tuple[Effect, ...] = (),
    ) -> None:
        self._integrate = _integrator(vehicle, step_s, tower, effects)
        # The compiled code is shared between flights and threads; what it writes to is not.
        self._memory = np.zeros(vehicle.n_x + vehicle.n_rotors + N_ZETA + 3)
        self.zeta: Array = np.asarray(zeta, dtype=float)
        """The true mismatch and wind bias from now on, eq. (4), shape (9,)."""
        self.x: Array = np.array(x, dtype=float)

    def advance(self, u: ArrayLike, w_g: ArrayLike, steps: int) -> None:
        """Fly on for some integration steps with input and gust held.

        Rotor accelerations u [Hz/s], shape (N_p,), are commanded: what the actuators cannot do is
        cut off. The gust force w_g, shape (3,), is in the world frame [N].
        """
        np.concatenate((self.x, u, self.zeta, w_g), out=self._memory)
        self._integrate(self._memory, steps)
        self.x = self._memory[: self.x.size].copy()


@lru_cache(maxsize=64)
def _integrator(
    vehicle: Vehicle, step_s: float, tower: Tower, effects: tuple[Effect, ...]
) -> Integrator:
    step = _plant_step(vehicle, step_s, tower, effects)
    try:
        return _compiled(step)
    except CompileError as error:
        warn_interpreted(error)
        return partial(_interpreted, step)


def _plant_step(
    vehicle: Vehicle, step_s: float, tower: Tower = TOWER, effects: tuple[Effect, ...] = ()
) -> ca.Function:
    """One RK4 step with the actuator limits applied: (x, u, zeta, w_g) -> x."""
    x, u, zeta, w_g = symbols(vehicle)
    limit = vehicle.max_rotor_acceleration_hz_s
    feasible = ca.fmin(ca.fmax(u, -limit), limit)
    feasible = ca.fmin(feasible, (vehicle.max_rotor_speed_hz - x[ROTORS]) / step_s)
    feasible = ca.fmax(feasible, (vehicle.min_rotor_speed_hz - x[ROTORS]) / step_s)

    def derivative(x: Any) -> Any:
        force, torque = w_g, ca.SX(3, 1)
        for effect in effects:
            more_force, more_torque = map(ca.SX, effect(x, zeta, vehicle, tower))
            if more_force.shape != (3, 1) or more_torque.shape != (3, 1):
                given = f"{more_force.shape} and {more_torque.shape}"
                raise ValueError(f"effect {effect.__name__}: shapes {given}, expected (3, 1) each")
            force, torque = force + more_force, torque + more_torque
        return state_derivative(x, feasible, zeta, force, vehicle, torque)

    x_next = rk4_step(x, step_s, derivative)
    return ca.Function("plant_step", [x, u, zeta, w_g], [x_next])


def _compiled(step: ca.Function) -> Integrator:
    n_x = step.size1_in(0)
    try:
        source = c_function(step)
    except NotImplementedError as error:
        raise CompileError(f"an effect cannot be compiled: {error}") from None
    library = load_library(
        "the plant",
        {"plant_step.c": f"#include <math.h>\n\n{source}\n{ADVANCE}"},
        # Without fused operations the results are those of CasADi's virtual machine, bit by bit.
        {"plant_step.c": ("-O2", "-ffp-contract=off", f"-DN_X={n_x}")},
    )
    library.plant_advance.restype = None

    def integrate(memory: Array, steps: int) -> None:
        library.plant_advance(ctypes.c_void_p(memory.ctypes.data), steps)

    return integrate


def _interpreted(step: ca.Function, memory: Array, steps: int) -> None:
    ends = np.cumsum([step.size1_in(i) for i in range(step.n_in())])
    x, *held = np.split(memory, ends[:-1])
    x[:] = np.asarray(_folded(step, steps)(x, *held)).ravel()


@lru_cache(maxsize=64)
def _folded(step: ca.Function, steps: int) -> ca.Function:
    x, *held = (ca.MX.sym("", step.size1_in(i)) for i in range(step.n_in()))
    end = step.fold(steps)(x, *(ca.repmat(h, 1, steps) for h in held))
    return ca.Function("plant_advance", [x, *held], [end])
