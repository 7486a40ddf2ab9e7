# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The true vehicle: eq. (3) with the true zeta, finer steps, actuator limits, and its world."""

import ctypes
import math
from collections.abc import Callable
from functools import cache, lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_codegen.c_source import c_function
from gtmr_codegen.library import CompileError, load_generated, load_library, warn_interpreted
from gtmr_model.dynamics import ROTORS, one_at_a_time, rk4_step, state_derivative, symbols
from gtmr_model.tower import Tower
from gtmr_model.vehicle import Vehicle
from gtmr_sim.worlds import motors
from gtmr_sim.worlds.wall import effect_of
from gtmr_sim.worlds.wind import wind_effect
from gtmr_sim.worlds.world import PAPER, World

Array = NDArray[np.float64]
TOWER = Tower()
Integrator = Callable[[Array, int], None]
"""Takes a plant's memory, in one row what its step takes and then the least squared distance from
the tower's axis so far [m^2], and moves on by a number of steps."""

Effect = Callable[[Any, Any, Vehicle, Tower], tuple[Any, Any]]
"""Maps CasADi symbols of x, shape (12 + N_p,), and zeta, shape (9,), with the nominal vehicle and
the tower, to an extra force, world frame [N], and torque, body frame [N m], each of shape (3,).
It is compiled into the plant, and evaluated within every step of the integration."""

ADVANCE = """
#include <string.h>

/* memory: the state, what is held, and the least squared distance from the tower's axis. */
void plant_advance(double *memory, int steps)
{
    double next[N_STATE];
    for (; steps > 0; --steps) {
        plant_step(memory, next);
        memcpy(memory, next, sizeof next);
        const double squared = next[0] * next[0] + next[1] * next[1];
        /* What is no number must not look like a flight that kept away. */
        if (!(squared >= memory[LEAST]))
            memory[LEAST] = squared;
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
    world : World
        Of which motors, wind and wall act here.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        zeta: ArrayLike,
        x: ArrayLike,
        step_s: float,
        tower: Tower = TOWER,
        effects: tuple[Effect, ...] = (),
        world: World = PAPER,
    ) -> None:
        self._integrate = _integrator(vehicle, step_s, tower, effects, world.in_plant)
        self.zeta: Array = np.asarray(zeta, dtype=float)
        """The true mismatch and wind bias from now on, eq. (4), shape (9,)."""
        self.x: Array = np.array(x, dtype=float)
        self.setpoints_hz: Array = self.x[ROTORS].copy() if world.motors else np.zeros(0)
        """Setpoints of the motors now [Hz], shape (N_p,); (0,) if there are none."""
        self.air_m_s: Array = np.zeros(3 if world.wind else 0)
        """Velocity of the air from now on, world frame, shape (3,) [m/s]; (0,) without wind."""
        self._tower = tower
        self._least = float(self.x[0] * self.x[0] + self.x[1] * self.x[1])

    @property
    def least_clearance_m(self) -> float:
        """Least d_T of any plant step so far, the start included [m]."""
        return float(self._tower.clearance([math.sqrt(self._least), 0.0]))

    def advance(self, u: ArrayLike, w_g: ArrayLike, steps: int) -> None:
        """Fly on for some integration steps with input and gust held.

        Rotor accelerations u [Hz/s], shape (N_p,), are commanded: what the actuators cannot do is
        cut off. Where there are motors, u is the rate of their setpoints. The gust force w_g,
        shape (3,), is in the world frame [N].
        """
        # The compiled code is shared between flights and threads; what it writes to is not.
        memory = np.concatenate(
            (self.x, self.setpoints_hz, u, self.zeta, w_g, self.air_m_s, (self._least,))
        )
        self._integrate(memory, steps)
        n_x = self.x.size
        self.x = memory[:n_x].copy()
        self.setpoints_hz = memory[n_x : n_x + self.setpoints_hz.size].copy()
        self._least = float(memory[-1])


@lru_cache(maxsize=64)
@one_at_a_time
def _integrator(
    vehicle: Vehicle, step_s: float, tower: Tower, effects: tuple[Effect, ...], world: World
) -> Integrator:
    @cache
    def step() -> ca.Function:
        return _plant_step(vehicle, step_s, tower, effects, world)

    try:
        if effects:
            # What a function of somebody else's gives, only its result says.
            return _compiled(step())
        values = (vehicle, step_s, tower, world)
        return _calling(load_generated("the plant", "gtmr_sim", values, lambda: _sources(step())))
    except CompileError as error:
        warn_interpreted(error)
        return partial(_interpreted, step())


def _plant_step(
    vehicle: Vehicle,
    step_s: float,
    tower: Tower = TOWER,
    effects: tuple[Effect, ...] = (),
    world: World = PAPER,
) -> ca.Function:
    """One RK4 step with the actuator limits applied: (state, u, zeta, w_g, air) -> state.

    The state is x, and the motors' setpoints where there are motors; air is empty without wind.
    """
    x, u, zeta, w_g = symbols(vehicle)
    air = ca.SX.sym("air", 3 if world.wind else 0)
    setpoints = ca.SX.sym("setpoints", vehicle.n_rotors if world.motors else 0)
    if world.wall is not None:
        effects = (*effects, effect_of(world.wall))
    limit = vehicle.max_rotor_acceleration_hz_s
    feasible = ca.fmin(ca.fmax(u, -limit), limit)
    feasible = ca.fmin(feasible, (vehicle.max_rotor_speed_hz - x[ROTORS]) / step_s)
    feasible = ca.fmax(feasible, (vehicle.min_rotor_speed_hz - x[ROTORS]) / step_s)

    def forces(x: Any) -> tuple[Any, Any]:
        force, torque = w_g, ca.SX(3, 1)
        for effect in effects:
            more_force, more_torque = map(ca.SX, effect(x, zeta, vehicle, tower))
            if more_force.shape != (3, 1) or more_torque.shape != (3, 1):
                given = f"{more_force.shape} and {more_torque.shape}"
                raise ValueError(f"effect {effect.__name__}: shapes {given}, expected (3, 1) each")
            force, torque = force + more_force, torque + more_torque
        if world.wind is not None:
            more_force, more_torque = wind_effect(world.wind, x, zeta, air, vehicle)
            force, torque = force + more_force, torque + more_torque
        return force, torque

    def derivative(state: Any) -> Any:
        x, xi_rate = state[: vehicle.n_x], feasible
        force, torque = forces(x)
        if world.motors is None:
            return state_derivative(x, xi_rate, zeta, force, vehicle, torque)
        told = state[vehicle.n_x :]
        xi_rate = motors.acceleration(x[ROTORS], told, world.motors, vehicle)
        return ca.vertcat(state_derivative(x, xi_rate, zeta, force, vehicle, torque), u)

    state = ca.vertcat(x, setpoints)
    state_next = rk4_step(state, step_s, derivative)
    return ca.Function("plant_step", [state, u, zeta, w_g, air], [state_next])


def _compiled(step: ca.Function) -> Integrator:
    return _calling(load_library("the plant", *_sources(step)))


def _sources(step: ca.Function) -> tuple[dict[str, str], dict[str, tuple[str, ...]]]:
    """Write the sources of the plant, and their flags."""
    sizes = [step.size1_in(i) for i in range(step.n_in())]
    try:
        source = c_function(step)
    except NotImplementedError as error:
        raise CompileError(f"an effect cannot be compiled: {error}") from None
    size = (f"-DN_STATE={sizes[0]}", f"-DLEAST={sum(sizes)}")
    return (
        {"plant_step.c": f"#include <math.h>\n\n{source}\n{ADVANCE}"},
        # Without fused operations the results are those of CasADi's virtual machine, bit by bit.
        {"plant_step.c": ("-O2", "-ffp-contract=off", *size)},
    )


def _calling(library: ctypes.CDLL) -> Integrator:
    library.plant_advance.restype = None

    def integrate(memory: Array, steps: int) -> None:
        library.plant_advance(ctypes.c_void_p(memory.ctypes.data), steps)

    return integrate


def _interpreted(step: ca.Function, memory: Array, steps: int) -> None:
    ends = np.cumsum([step.size1_in(i) for i in range(step.n_in())])
    state, *held, least = np.split(memory, ends)
    states = np.asarray(_folded(step, steps)(state, *held))
    state[:] = states[:, -1]
    least[0] = np.minimum(least[0], (states[0] * states[0] + states[1] * states[1]).min())


@lru_cache(maxsize=64)
@one_at_a_time
def _folded(step: ca.Function, steps: int) -> ca.Function:
    """Give the states after each of some steps, one a column."""
    state, *held = (ca.MX.sym("", step.size1_in(i)) for i in range(step.n_in()))
    states = step.mapaccum(steps)(state, *(ca.repmat(h, 1, steps) for h in held))
    return ca.Function("plant_advance", [state, *held], [states])
