# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Min-max NMPC by its vertices: the plan whose worst cost over vertices of zeta is least.

It assumes that zeta is one of the vertices and, as a plan is one sequence of inputs for all of
them, that nobody will steer back. It has the cost of the other families. Nothing was tuned, since
it does not fly: where a step may take 0.025 s, IPOPT takes 0.09 s of processor time, from a warm
start, for the smallest instance that says anything, the four vertices of the horizontal wind over
5 stages, 0.34 s over the whole horizon of 20, and 0.69 s with eight vertices; the box has 512.
`seconds_of_a_step` measures it again.

Its friends say that it is the problem all others approximate. The worst of the costs is no sum of
squares, so that no QP of ours solves it; but the constraints at all vertices under one sequence
of inputs are those of `ScenarioTree` with as many common stages as the horizon has, which flies,
and differs by taking the mean of the costs.
"""

from __future__ import annotations

import itertools
import time
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model import N_ZETA
from gtmr_model.dynamics import (
    ROTORS,
    VELOCITY,
    discrete_step,
    one_at_a_time,
    state_derivative,
    symbols,
)
from gtmr_nmpc import ControllerConfig
from gtmr_study.solvers.nlp import references, stage_cost, terminal_cost

Array = NDArray[np.float64]


def vertices(config: ControllerConfig, channels: tuple[int, ...]) -> Array:
    """Vertices of the box of some channels of zeta, the others 0, shape (2^n, 9)."""
    box = config.uncertainty.half_widths
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=len(channels))))
    zetas = np.zeros((len(signs), N_ZETA))
    zetas[:, list(channels)] = signs * box[list(channels)]
    return zetas


class MinMax:
    """One plan of inputs for all vertices, by multiple shooting in IPOPT.

    The worst cost is a variable that bounds the costs of all vertices; the clearance is soft at
    each of them, as in eq. (5). RuntimeError of `solve` if IPOPT finds no solution.
    """

    @one_at_a_time
    def __init__(self, config: ControllerConfig, zetas: Array) -> None:
        self.config = config
        n, vehicle = config.horizon, config.vehicle
        xs, us, zs, ws = symbols(vehicle)
        step_of = discrete_step(xs, us, zs, ca.DM.zeros(3), vehicle, config.sampling_time_s)
        rate = state_derivative(xs, us, zs, ws, vehicle)[VELOCITY]
        step = ca.Function("step", [xs, us, zs], [step_of])
        acceleration = ca.Function("acceleration", [xs, us, zs, ws], [rate])
        reference = ca.MX.sym("reference", 10, n + 1)
        x0, u, worst = (
            ca.MX.sym("x0", vehicle.n_x),
            ca.MX.sym("u", vehicle.n_rotors, n),
            ca.MX.sym("worst"),
        )
        slack = ca.MX.sym("slack", n, len(zetas))
        states, gaps, above = [], [], []
        for v, zeta in enumerate(zetas):
            x = ca.MX.sym(f"x{v}", vehicle.n_x, n)
            cost = config.slack_l1 * ca.sum1(slack[:, v]) + config.slack_l2 * ca.sumsqr(
                slack[:, v]
            )
            at = x0
            for i in range(n):
                a = acceleration(at, u[:, i], zeta, ca.DM.zeros(3))
                cost += stage_cost(config, at, u[:, i], a, reference[:, i])
                gaps.append(step(at, u[:, i], zeta) - x[:, i])
                at = x[:, i]
            cost += terminal_cost(config, at, reference[:, n])
            distance = ca.sqrt(x[0, :] ** 2 + x[1, :] ** 2).T - config.tower.radius_m
            above += [worst - cost, distance + slack[:, v] - config.tower.min_clearance_m]
            states.append(x)
        variables = ca.veccat(u, worst, slack, *states)
        self._n_above = ca.vertcat(*above).numel()
        self._n_gaps = ca.vertcat(*gaps).numel()
        program: Any = {
            "x": variables,
            "p": ca.veccat(x0, reference),
            "f": worst,
            "g": ca.vertcat(*gaps, *above),
        }
        options: dict[str, Any] = {
            "ipopt.print_level": 0,
            "print_time": False,
            "ipopt.sb": "yes",
            "ipopt.tol": 1e-6,
        }
        self._solver = ca.nlpsol("min_max", "ipopt", program, options)
        self._count = len(zetas)

    def solve(self, t: float, x0: Array, guess: Array | None = None) -> tuple[Array, Array]:
        """Plan from a state at time t [s]: inputs [Hz/s], shape (N, N_p), and the whole solution.

        The solution of the step before is a ``guess``.
        """
        config, n, vehicle, m = self.config, self.config.horizon, self.config.vehicle, self._count
        limit = vehicle.max_rotor_acceleration_hz_s
        low, high = (np.full((m, n, vehicle.n_x), bound) for bound in (-np.inf, np.inf))
        low[:, :, ROTORS], high[:, :, ROTORS] = (
            vehicle.min_rotor_speed_hz,
            vehicle.max_rotor_speed_hz,
        )
        inputs = np.full(n * vehicle.n_rotors, limit)
        hold = np.r_[0.0 * inputs, 0.0, np.zeros(n * m), np.tile(x0, n * m)]
        result = self._solver(
            x0=hold if guess is None else guess,
            p=np.r_[x0, references(config, t).ravel()],
            lbx=np.r_[-inputs, -np.inf, np.zeros(n * m), low.ravel()],
            ubx=np.r_[inputs, np.inf, np.full(n * m, np.inf), high.ravel()],
            lbg=0.0,
            ubg=np.r_[np.zeros(self._n_gaps), np.full(self._n_above, np.inf)],
        )
        if not self._solver.stats()["success"]:
            raise RuntimeError(f"IPOPT: {self._solver.stats()['return_status']}")
        solution = np.asarray(result["x"]).ravel()
        return solution[: inputs.size].reshape(n, -1), solution


def seconds_of_a_step(
    config: ControllerConfig, channels: tuple[int, ...], steps: int = 3
) -> float:
    """Measure the median processor time of warm steps along the nominal reference [s].

    With vertices of these channels of zeta: 6 and 7 are the wind's horizontal ones.
    """
    controller, x = (
        MinMax(config, vertices(config, channels)),
        config.helix.initial_state(config.tower, config.vehicle),
    )
    _, guess = controller.solve(0.0, x)
    times_s = []
    for k in range(1, steps + 1):
        t = k * config.sampling_time_s
        at = config.helix.at(t, config.tower)
        x[:3], x[5], x[VELOCITY] = at.position[0], at.yaw[0], at.velocity[0]
        start = time.process_time()
        _, guess = controller.solve(t, x, guess)
        times_s.append(time.process_time() - start)
    return float(np.median(times_s))
