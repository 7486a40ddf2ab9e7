"""The true vehicle: eq. (3) with the true zeta, a fine integration step and actuator limits."""

from __future__ import annotations

from functools import lru_cache, partial

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_model.dynamics import ROTORS, rk4_step, state_derivative, symbols
from gtmr_model.vehicle import Vehicle


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
        self._integrator = partial(_integrator, vehicle, step_s)
        self._integrate: dict[int, ca.Function] = {}
        self._zeta = np.asarray(zeta, dtype=float)
        self.x: NDArray[np.float64] = np.array(x, dtype=float)

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
        if steps not in self._integrate:
            self._integrate[steps] = self._integrator(steps)
        held = np.asarray(u, dtype=float), self._zeta, np.asarray(w_g, dtype=float)
        self.x = np.asarray(self._integrate[steps](self.x, *held)).ravel()


@lru_cache(maxsize=64)
def _integrator(vehicle: Vehicle, step_s: float, steps: int) -> ca.Function:
    """Compose ``steps`` RK4 steps, with the actuator limits applied in each."""
    x, u, zeta, w_g = symbols(vehicle)
    limit = vehicle.max_rotor_acceleration_hz_s
    feasible = ca.fmin(ca.fmax(u, -limit), limit)
    feasible = ca.fmin(feasible, (vehicle.max_rotor_speed_hz - x[ROTORS]) / step_s)
    feasible = ca.fmax(feasible, (vehicle.min_rotor_speed_hz - x[ROTORS]) / step_s)
    x_next = rk4_step(x, step_s, lambda x: state_derivative(x, feasible, zeta, w_g, vehicle))
    one = ca.Function(
        "plant_step", [x, u, zeta, w_g], [x_next], ["x", "u", "zeta", "w_g"], ["x_next"]
    )

    x0, *held = (ca.MX.sym(name, one.size1_in(i)) for i, name in enumerate(one.name_in()))
    end = one.fold(steps)(x0, *(ca.repmat(h, 1, steps) for h in held))
    return ca.Function("plant_advance", [x0, *held], [end])
