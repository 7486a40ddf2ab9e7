# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The true vehicle: eq. (3) with the true zeta, finer steps, actuator limits, and its world."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from functools import cache, lru_cache, partial
from itertools import pairwise
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
int plant_advance(double *memory, int steps)
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
    return 0;
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
        x = np.asarray(x, dtype=float)
        setpoints = x[ROTORS] if world.motors else np.zeros(0)
        air = np.zeros(3 if world.wind else 0)
        least = float(x[0] * x[0] + x[1] * x[1])
        zeta, held = np.asarray(zeta, dtype=float), np.zeros(vehicle.n_rotors)
        parts = (x, setpoints, held, zeta, np.zeros(3), air, (least,))
        # The compiled code is shared between flights and threads; what it writes to is not.
        self.memory: Array = np.concatenate(parts)
        """What the compiled step works on: state and setpoints, input, zeta, gust, air, and the
        least squared distance from the tower's axis so far [m^2]."""
        self._starts = np.cumsum([0, *map(len, parts)]).tolist()
        self._look_at_memory()
        self._tower = tower

    def _look_at_memory(self) -> None:
        views = [self.memory[i:j] for i, j in pairwise(self._starts)]
        self._x, self._setpoints_hz, self._u, self._zeta, self._w_g, self._air_m_s, _ = views

    def __copy__(self) -> Plant:
        """Give a plant that flies on by itself from here."""
        other = object.__new__(type(self))
        vars(other).update(vars(self))
        other.memory = self.memory.copy()
        other._look_at_memory()
        return other

    @property
    def x(self) -> Array:
        """State now, shape (12 + N_p,); a copy."""
        return self._x.copy()

    @x.setter
    def x(self, x: ArrayLike) -> None:
        self._x[:] = x

    @property
    def zeta(self) -> Array:
        """The true mismatch and wind bias from now on, eq. (4), shape (9,); a copy."""
        return self._zeta.copy()

    @zeta.setter
    def zeta(self, zeta: ArrayLike) -> None:
        self._zeta[:] = zeta

    @property
    def setpoints_hz(self) -> Array:
        """Setpoints of the motors now [Hz], shape (N_p,); (0,) if there are none; a copy."""
        return self._setpoints_hz.copy()

    @setpoints_hz.setter
    def setpoints_hz(self, setpoints_hz: ArrayLike) -> None:
        self._setpoints_hz[:] = setpoints_hz

    @property
    def air_m_s(self) -> Array:
        """Velocity of the air from now on, world frame [m/s], shape (3,); (0,) without wind.

        A copy.
        """
        return self._air_m_s.copy()

    @air_m_s.setter
    def air_m_s(self, air_m_s: ArrayLike) -> None:
        self._air_m_s[:] = air_m_s

    @property
    def u(self) -> Array:
        """Input that was commanded last [Hz/s], shape (N_p,); a copy."""
        return self._u.copy()

    @property
    def w_g(self) -> Array:
        """Gust that acted last, world frame [N], shape (3,); a copy."""
        return self._w_g.copy()

    @property
    def least_clearance_m(self) -> float:
        """Least d_T of any plant step so far, the start included [m]."""
        return float(self._tower.clearance([math.sqrt(self.memory[-1]), 0.0]))

    def advance(self, u: ArrayLike, w_g: ArrayLike, steps: int) -> None:
        """Fly on for some integration steps with input and gust held.

        Rotor accelerations u [Hz/s], shape (N_p,), are commanded: what the actuators cannot do is
        cut off. Where there are motors, u is the rate of their setpoints. The gust force w_g,
        shape (3,), is in the world frame [N].
        """
        self._u[:] = u
        self._w_g[:] = w_g
        self._integrate(self.memory, steps)

    @property
    def addresses(self) -> tuple[int, ...]:
        """Where x, the setpoints, u, w_g and the air lie in its memory, for compiled code."""
        views = (self._x, self._setpoints_hz, self._u, self._w_g, self._air_m_s)
        return tuple(view.ctypes.data for view in views)

    @property
    def function(self) -> int | None:
        """Address of the compiled `advance`, which takes its memory and a number of steps.

        None where it is not compiled, or a class of yours has an ``advance`` of its own.
        """
        own = type(self).advance is not Plant.advance
        return None if own else getattr(self._integrate, "address", None)


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
        return _Compiled(load_generated("the plant", "gtmr_sim", values, lambda: _sources(step())))
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
    return _Compiled(load_library("the plant", *_sources(step)))


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


class _Compiled:
    """An `Integrator` in C."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._advance = library.plant_advance
        self.address = ctypes.cast(self._advance, ctypes.c_void_p).value
        """Of the function in memory."""

    def __call__(self, memory: Array, steps: int) -> None:
        self._advance(ctypes.c_void_p(memory.ctypes.data), steps)


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
