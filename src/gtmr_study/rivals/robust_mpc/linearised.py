# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Jacobians of the steps of a plan, compiled: they are most of what an ellipsoid costs."""

from __future__ import annotations

import ctypes
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_codegen.c_source import c_function
from gtmr_codegen.library import CompileError, load_library, warn_interpreted
from gtmr_model import N_ZETA, Vehicle
from gtmr_model.dynamics import discrete_step, one_at_a_time, symbols

Array = NDArray[np.float64]

ALL_STEPS = """
void jacobians_of(const double *in, double *out, int steps)
{
    for (int i = 0; i < steps; ++i)
        jacobians(in + i * N_IN, out + i * N_OUT);
}
"""


@lru_cache(maxsize=8)
@one_at_a_time
def jacobians(vehicle: Vehicle, step_s: float) -> ca.Function:
    """(x, u) -> dF/dx, dF/du, dF/dzeta and dF/dw_g of one RK4 step, at zeta = 0 without gust."""
    x, u, zeta, w_g = symbols(vehicle)
    x_next = discrete_step(x, u, zeta, w_g, vehicle, step_s)
    blocks = [ca.jacobian(x_next, of) for of in (x, u, zeta, w_g)]
    nominal = [ca.vertcat(zeta, w_g)], [ca.DM.zeros(N_ZETA + 3)]
    blocks = [ca.densify(block) for block in ca.substitute(blocks, *nominal)]
    return ca.Function("jacobians", [x, u], ca.cse(blocks))


def linearise(vehicle: Vehicle, step_s: float, x: Array, u: Array) -> tuple[Array, ...]:
    """Evaluate A, B, E and G of a plan's steps, shapes (N, n_x, n_x), (N, n_x, N_p), ...

    States x have shape (N, 12 + N_p), inputs u, [Hz/s], shape (N, N_p).
    """
    library, widths = _library(vehicle, step_s), (vehicle.n_x, vehicle.n_rotors, N_ZETA, 3)
    steps = len(u)
    if library is None:
        function = jacobians(vehicle, step_s)
        points = [[np.asarray(j) for j in function(*at)] for at in zip(x, u, strict=True)]
        return tuple(np.array(blocks) for blocks in zip(*points, strict=True))
    given = np.hstack([x, u])
    result = np.empty((steps, vehicle.n_x * sum(widths)))
    library.jacobians_of(
        ctypes.c_void_p(given.ctypes.data), ctypes.c_void_p(result.ctypes.data), steps
    )
    # CasADi stores columns.
    blocks = np.split(result, np.cumsum([vehicle.n_x * width for width in widths[:-1]]), axis=1)
    return tuple(
        block.reshape(steps, width, vehicle.n_x).transpose(0, 2, 1)
        for block, width in zip(blocks, widths, strict=True)
    )


@lru_cache(maxsize=8)
def _library(vehicle: Vehicle, step_s: float) -> ctypes.CDLL | None:
    function = jacobians(vehicle, step_s)
    sizes = f"-DN_IN={function.nnz_in()}", f"-DN_OUT={function.nnz_out()}"
    source = f"#include <math.h>\n\n{c_function(function)}\n{ALL_STEPS}"
    flags = ("-O2", "-ffp-contract=off", *sizes)
    try:
        library = load_library("Jacobians", {"jacobians.c": source}, {"jacobians.c": flags})
    except CompileError as error:
        warn_interpreted(error)
        return None
    library.jacobians_of.restype = None
    return library
