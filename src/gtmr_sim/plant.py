# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The true vehicle: eq. (3) with the true zeta, a fine integration step and actuator limits."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import lru_cache, partial

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_codegen.c_source import c_function
from gtmr_codegen.library import CompileError, load_library, warn_interpreted
from gtmr_model.dynamics import ROTORS, discrete_step, symbols
from gtmr_model.uncertainty import N_ZETA
from gtmr_model.vehicle import Vehicle

Array = NDArray[np.float64]
Integrator = Callable[[Array, int], None]
"""Takes a plant's memory, x, u, zeta and w_g in one row, and moves x on by a number of steps."""

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
    """A vehicle in flight.

    Parameters
    ----------
    vehicle : Vehicle
        Nominal parameters.
    zeta : array_like, shape (9,)
        The true mismatch and wind bias, eq. (4).
    x : array_like, shape (12 + N_p,)
        State to start from.
    step_s : float
        Integration step [s].
    """

    def __init__(self, vehicle: Vehicle, zeta: ArrayLike, x: ArrayLike, step_s: float) -> None:
        self._integrate = _integrator(vehicle, step_s)
        # The compiled code is shared between flights and threads; what it writes to is not.
        self._memory = np.zeros(vehicle.n_x + vehicle.n_rotors + N_ZETA + 3)
        self.zeta: Array = np.asarray(zeta, dtype=float)
        """The true mismatch and wind bias from now on, eq. (4), shape (9,)."""
        self.x: Array = np.array(x, dtype=float)

    def advance(self, u: ArrayLike, w_g: ArrayLike, steps: int) -> None:
        """Fly on with input and gust held.

        Parameters
        ----------
        u : array_like, shape (N_p,)
            Commanded rotor accelerations [Hz/s]; what the actuators cannot do is cut off.
        w_g : array_like, shape (3,)
            Gust force, world frame [N].
        steps : int
            Number of integration steps.
        """
        np.concatenate((self.x, u, self.zeta, w_g), out=self._memory)
        self._integrate(self._memory, steps)
        self.x = self._memory[: self.x.size].copy()


@lru_cache(maxsize=64)
def _integrator(vehicle: Vehicle, step_s: float) -> Integrator:
    step = _plant_step(vehicle, step_s)
    try:
        return _compiled(step)
    except CompileError as error:
        warn_interpreted(error)
        return partial(_interpreted, step)


def _plant_step(vehicle: Vehicle, step_s: float) -> ca.Function:
    """One RK4 step with the actuator limits applied: (x, u, zeta, w_g) -> x."""
    x, u, zeta, w_g = symbols(vehicle)
    limit = vehicle.max_rotor_acceleration_hz_s
    feasible = ca.fmin(ca.fmax(u, -limit), limit)
    feasible = ca.fmin(feasible, (vehicle.max_rotor_speed_hz - x[ROTORS]) / step_s)
    feasible = ca.fmax(feasible, (vehicle.min_rotor_speed_hz - x[ROTORS]) / step_s)
    x_next = discrete_step(x, feasible, zeta, w_g, vehicle, step_s)
    return ca.Function("plant_step", [x, u, zeta, w_g], [x_next])


def _compiled(step: ca.Function) -> Integrator:
    n_x = step.size1_in(0)
    library = load_library(
        "the plant",
        {"plant_step.c": f"#include <math.h>\n\n{c_function(step)}\n{ADVANCE}"},
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
