# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The OCP as a nonlinear program: an oracle, which states cost, shooting and constraints anew.

It shares only the equations of motion with the controller, so that general solvers of this
program check the controller, and are what it is measured against.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model import N_ZETA, ConfigError, Helix
from gtmr_model.dynamics import (
    ATTITUDE,
    POSITION,
    RATE,
    ROTORS,
    VELOCITY,
    rk4_step,
    state_derivative,
    symbols,
)
from gtmr_nmpc import ControllerConfig

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NlpSolution:
    """A solution of the program."""

    x: Array
    """States, shape (N + 1, 12 + N_p)."""
    u: Array
    """Rotor accelerations [Hz/s], shape (N, N_p)."""
    slack: Array
    """Violation of the tightened clearance at stages 1..N [m], shape (N,)."""
    cost: float
    """Objective, penalty included."""


class InspectionNlp:
    """Eq. (5) with given margins, or eq. (15) itself, with the clearance softened exactly.

    ``solver`` and ``options`` are those of a CasADi NLP solver, for example ``ipopt``. Margins are
    data (held at given values) or eq. (12) in terms of the plan. ``condensed`` eliminates the
    states (single shooting), as dense QP solvers want it. ``disturbance`` is a force in the world
    frame [N] and a torque in the body frame [N m] at every stage, shape (N, 6); none if left out.
    """

    def __init__(
        self,
        config: ControllerConfig,
        solver: str,
        options: dict[str, Any],
        margins_given: bool = True,
        condensed: bool = False,
        disturbance: Array | None = None,
    ) -> None:
        if config.clearance_of != "centre":
            raise ConfigError(
                f"clearance_of = {config.clearance_of!r}: this program has the clearance of the "
                "'centre' alone"
            )
        self.config = config
        if disturbance is None:
            disturbance = np.zeros((config.horizon, 6))
        n, vehicle = config.horizon, config.vehicle
        u = ca.MX.sym("u", vehicle.n_rotors, n)
        x0 = ca.MX.sym("x0", vehicle.n_x if condensed else 0)
        x = (
            _rollout(config, x0, u, disturbance)
            if condensed
            else ca.MX.sym("x", vehicle.n_x, n + 1)
        )
        slack = ca.MX.sym("slack", n)
        reference = ca.MX.sym("reference", 10, n + 1)
        margin = ca.MX.sym("margin", n if margins_given else 0)
        gaps, alpha = _shooting(config, x, u, margins_given, disturbance)
        if condensed:
            gaps = ca.vec(x[ROTORS, 1:])
        rho = ca.sqrt(x[0, 1:] ** 2 + x[1, 1:] ** 2).T
        clearance = rho - config.tower.radius_m
        tightened = config.tower.min_clearance_m - clearance + (margin if margins_given else alpha)
        cost = _cost(config, x, u, reference, disturbance)
        cost += config.slack_l1 * ca.sum1(slack) + config.slack_l2 * ca.sumsqr(slack)
        # The stubs of CasADi know programs on SX only.
        program: Any = {
            "x": ca.veccat(u, slack) if condensed else ca.veccat(x, u, slack),
            "p": ca.veccat(x0, reference, margin),
            "f": cost,
            "g": ca.vertcat(gaps, tightened - slack),
        }
        self._solver = ca.nlpsol("nlp", solver, program, options)
        self._cost = self._states = None
        if condensed:
            self._states = ca.Function("states", [x0, u], [x])
        else:
            self._cost = ca.Function("cost", [x, u, slack, reference], [cost])

    def solve(
        self, t: float, x0: Array, alpha: Array | None, guess: NlpSolution | None
    ) -> NlpSolution:
        """Solve at time t [s] for a measured state, shape (12 + N_p,), its yaw near the helix's.

        ``alpha``: margins [m], shape (N + 1,); None where they are terms of the plan. ``guess``:
        where to start; None for the state held over the horizon. RuntimeError if the solver says
        that it failed, other than by its iteration limit.
        """
        vehicle, n = self.config.vehicle, self.config.horizon
        reference = references(self.config, t)
        start = guess or NlpSolution(
            np.tile(x0, (n + 1, 1)), np.zeros((n, vehicle.n_rotors)), np.zeros(n), np.inf
        )
        lower, upper = (np.full((n + 1, vehicle.n_x), bound) for bound in (-np.inf, np.inf))
        lower[1:, ROTORS] = vehicle.min_rotor_speed_hz
        upper[1:, ROTORS] = vehicle.max_rotor_speed_hz
        lower[0] = upper[0] = x0
        limit = np.full(n * vehicle.n_rotors, vehicle.max_rotor_acceleration_hz_s)
        rest = np.r_[start.u.ravel(), start.slack]
        lower_rest, upper_rest = np.r_[-limit, np.zeros(n)], np.r_[limit, np.full(n, np.inf)]
        data = np.r_[reference.ravel(), alpha[1:] if alpha is not None else []]
        # The clearance is bounded from above alone.
        unbounded, none = np.full(n, -np.inf), np.zeros(n)
        if self._states is not None:
            result = self._solver(
                x0=rest,
                p=np.r_[x0, data],
                lbx=lower_rest,
                ubx=upper_rest,
                lbg=np.r_[lower[1:, ROTORS].ravel(), unbounded],
                ubg=np.r_[upper[1:, ROTORS].ravel(), none],
            )
        else:
            result = self._solver(
                x0=np.r_[start.x.ravel(), rest],
                p=data,
                lbx=np.r_[lower.ravel(), lower_rest],
                ubx=np.r_[upper.ravel(), upper_rest],
                lbg=np.r_[np.zeros(n * vehicle.n_x), unbounded],
                ubg=0.0,
            )
        stats = self._solver.stats()
        if not stats["success"] and "iter" not in stats["return_status"].lower():
            raise RuntimeError(stats["return_status"])
        flat = np.asarray(result["x"]).ravel()
        states, inputs = (n + 1) * vehicle.n_x, n * vehicle.n_rotors
        if self._states is not None:
            u_plan = flat[:inputs].reshape(n, -1)
            x_plan = np.asarray(self._states(x0, u_plan.T)).T
        else:
            x_plan = flat[:states].reshape(n + 1, -1)
            u_plan = flat[states : states + inputs].reshape(n, -1)
        return NlpSolution(x=x_plan, u=u_plan, slack=flat[-n:], cost=float(result["f"]))

    def cost(self, t: float, x: Array, u: Array, slack: Array) -> float:
        """Evaluate the objective at a plan; not for condensed programs."""
        if self._cost is None:
            raise ValueError("a condensed program has no states to evaluate its cost at")
        return float(self._cost(x.T, u.T, slack, references(self.config, t).T))


def _discrete(config: ControllerConfig) -> tuple[ca.Function, ca.Function]:
    """One shooting interval, (x, u, zeta, disturbance) -> x_next; derivatives by x and zeta."""
    xs, us, zs, force = symbols(config.vehicle)
    torque = ca.SX.sym("torque", 3)
    x_next = rk4_step(
        xs,
        config.sampling_time_s,
        lambda x: state_derivative(x, us, zs, force, config.vehicle, torque),
    )
    given = [xs, us, zs, ca.vertcat(force, torque)]
    jacobians = [ca.jacobian(x_next, s) for s in (xs, zs)]
    return ca.Function("F", given, [x_next]), ca.Function("dF", given, jacobians)


def _rollout(config: ControllerConfig, x0: ca.MX, u: ca.MX, disturbance: Array) -> ca.MX:
    """States over the horizon as functions of the first one and the inputs."""
    discrete, _ = _discrete(config)
    states = [x0]
    for i in range(config.horizon):
        states.append(discrete(states[-1], u[:, i], ca.DM.zeros(N_ZETA), disturbance[i]))
    return ca.horzcat(*states)


def _shooting(
    config: ControllerConfig, x: ca.MX, u: ca.MX, margins_given: bool, disturbance: Array
) -> tuple[ca.MX, ca.MX]:
    """Shooting gaps, and alpha_p + alpha_g of stages 1..N where the program carries them."""
    vehicle, step_s = config.vehicle, config.sampling_time_s
    discrete, jacobians = _discrete(config)
    nominal = ca.DM.zeros(N_ZETA)
    min_mass_kg = (1.0 - config.uncertainty.mass) * vehicle.mass_kg
    gaps, alpha = [], []
    pi: Any = ca.DM.zeros(vehicle.n_x, N_ZETA)
    for i in range(config.horizon):
        gaps.append(discrete(x[:, i], u[:, i], nominal, disturbance[i]) - x[:, i + 1])
        if margins_given:
            continue
        a, e = jacobians(x[:, i], u[:, i], nominal, disturbance[i])
        pi = a @ pi + e
        p = x[POSITION, i + 1]
        rho = ca.sqrt(p[0] ** 2 + p[1] ** 2)
        pi_y = ca.horzcat(-p[0] / rho, -p[1] / rho) @ pi[:2, :]
        gust = 0.5 * config.uncertainty.gust_n / min_mass_kg * (step_s * (i + 1)) ** 2
        parametric = ca.fabs(pi_y) @ ca.DM(config.uncertainty.half_widths) + config.eps_s_m
        alpha.append(parametric + gust)
    return ca.vertcat(*gaps), ca.vertcat(*alpha)


def _cost(
    config: ControllerConfig, x: ca.MX, u: ca.MX, reference: ca.MX, disturbance: Array
) -> ca.MX:
    """Cost over the horizon; no penalty on slacks."""
    xs, us, zs, ws = symbols(config.vehicle)
    rate = state_derivative(xs, us, zs, ws, config.vehicle)
    dynamics = ca.Function("f", [xs, us, zs, ws], [rate])
    cost = ca.MX(0.0)
    for i in range(config.horizon):
        xi, ui = x[:, i], u[:, i]
        acceleration = dynamics(xi, ui, ca.DM.zeros(N_ZETA), disturbance[i, :3])[VELOCITY]
        cost += stage_cost(config, xi, ui, acceleration, reference[:, i])
    last = config.horizon
    return cost + terminal_cost(config, x[:, last], reference[:, last])


def stage_cost(config: ControllerConfig, x: Any, u: Any, acceleration: Any, r: Any) -> Any:
    """Cost of a stage, eq. (6) with this project's terms on attitude and rate.

    The reference r is position, velocity, acceleration and yaw, 10 numbers.
    """
    w, attitude = config.weights, x[ATTITUDE]
    yaw_rate = Helix.required(config.helix).at(0.0, config.tower).yaw_rate[0]
    return (
        _weighted(w.position, x[POSITION] - r[0:3])
        + _weighted(w.velocity, x[VELOCITY] - r[3:6])
        + _weighted(w.acceleration, acceleration - r[6:9])
        + w.roll_pitch * ca.sumsqr(attitude[:2])
        + w.yaw * (attitude[2] - r[9]) ** 2
        + w.rate * ca.sumsqr(x[RATE] - ca.DM([0.0, 0.0, yaw_rate]))
        + w.rotor_acceleration * ca.sumsqr(u)
    )


def terminal_cost(config: ControllerConfig, x: Any, r: Any) -> Any:
    """Cost of the last stage, eq. (6), with the reference as `stage_cost` takes it."""
    return _weighted(config.weights.terminal_position, x[POSITION] - r[0:3])


def _weighted(weights: tuple[float, ...], error: Any) -> Any:
    return ca.dot(ca.DM(weights), error * error)


def references(config: ControllerConfig, t: float) -> Array:
    """Look up the references of a horizon that begins at t [s], shape (N + 1, 10)."""
    at = config.helix.at(t + config.sampling_time_s * np.arange(config.horizon + 1), config.tower)
    return np.hstack([at.position, at.velocity, at.acceleration, at.yaw[:, None]])
