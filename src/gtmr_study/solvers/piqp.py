# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""PIQP on the QPs of the controller."""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model.dynamics import POSITION, ROTORS
from gtmr_nmpc import ControllerConfig, ocp
from gtmr_study.solvers.qp import REPEATS, RecordedStep

Array = NDArray[np.float64]


class PiqpRival:
    """PIQP on the sparse QP in states, inputs and slacks, stage by stage.

    The measured state is eliminated. Structure and scaling are set up where a flight starts; the
    time is that of updating the numbers and of the solution. An interior point method, always
    from nothing: it has no warm start. ModuleNotFoundError if it is not installed.
    """

    def __init__(self, config: ControllerConfig) -> None:
        import piqp

        self._solved = piqp.PIQP_SOLVED
        self._data = SparseQp(config)
        self._solver: Any = piqp.SparseSolver()
        settings = self._solver.settings
        # The fastest of what it offers: a block tridiagonal factorisation, scaled once.
        settings.kkt_solver = piqp.KKTSolver.sparse_multistage
        settings.preconditioner_reuse_on_update = True
        settings.compute_timings = True
        self._is_set_up = False

    def start(self) -> None:
        """See `QpRival.start`; scales anew."""
        self._is_set_up = False

    def solve(self, step: RecordedStep) -> tuple[Array, float]:
        """See `QpRival.solve`."""
        qp = self._data.at(step)
        if not self._is_set_up:
            self._solver.setup(*qp)
            self._is_set_up = True
        times_s = []
        for _ in range(REPEATS):
            self._solver.update(*qp)
            status = self._solver.solve()
            told = self._solver.result.info
            times_s.append(told.update_time + told.solve_time)
        if status != self._solved:
            raise RuntimeError(f"PIQP: {status}")
        u = step.iterate.u[0]
        return u + self._solver.result.x[: len(u)], min(times_s)


class SparseQp:
    """The QP with states kept: du_0, then dx_i, slack_i and du_i of each stage.

    Structural zeros come from CasADi, and are the same in every step.
    """

    def __init__(self, config: ControllerConfig) -> None:
        self._config = config
        n, n_x, n_u = config.horizon, config.vehicle.n_x, config.vehicle.n_rotors
        self._reach = config.sampling_time_s * np.arange(1, n + 1)[:, None]
        f, h = ocp.discrete_dynamics(config), ocp.output_map(config)
        x, u, dx0 = ca.SX.sym("x", n_x, n + 1), ca.SX.sym("u", n_u, n), ca.SX.sym("dx0", n_x)
        reference = ca.SX.sym("reference", ocp.N_H, n)
        terminal = ca.SX.sym("terminal", 3)
        rows = ca.SX.sym("rows", 3, n)
        xs, us = ca.SX.sym("xs", n_x), ca.SX.sym("us", n_u)
        x_next, output = f(xs, us, 0), h(xs)
        jacobians = [ca.jacobian(x_next, xs), ca.jacobian(x_next, us), ca.jacobian(output, xs)]
        stage = ca.Function("stage", [xs, us], [x_next, output, *jacobians])
        q = ca.DM(ocp.stage_weights(config))
        q_u, q_f = config.weights.rotor_acceleration, ca.DM(config.weights.terminal_position)
        p, c, a, b, g = [], [], [], [], []
        # Variables by stage, as symbols of which the Jacobians are taken.
        dx = [dx0, *(ca.SX.sym(f"dx{i}", n_x) for i in range(1, n + 1))]
        du = [ca.SX.sym(f"du{i}", n_u) for i in range(n)]
        slack = [ca.SX.sym(f"s{i}") for i in range(1, n + 1)]
        for i in range(n):
            x_next, y, a_i, b_i, dy = stage(x[:, i], u[:, i])
            p.append(2.0 * q_u * ca.SX.eye(n_u))
            c.append(2.0 * q_u * u[:, i])
            if i > 0:
                weighed = 2.0 * dy.T @ ca.diag(q)
                p[-1:-1] = [weighed @ dy, ca.SX(2.0 * config.slack_l2)]
                c[-1:-1] = [weighed @ (y - reference[:, i]), ca.SX(config.slack_l1)]
            a.append(a_i @ dx[i] + b_i @ du[i] - dx[i + 1])
            b.append(x[:, i + 1] - x_next)
            g.append(ca.dot(rows[:, i], dx[i + 1][POSITION]) - slack[i])
        last = ca.SX(n_x, n_x)
        last[POSITION, POSITION] = ca.diag(2.0 * q_f)
        tail = ca.vertcat(2.0 * q_f * (x[POSITION, n] - terminal), ca.SX.zeros(n_x - 3))
        p += [last, ca.SX(2.0 * config.slack_l2)]
        c += [tail, ca.SX(config.slack_l1)]
        variables = [du[0]]
        for i in range(1, n + 1):
            variables += [dx[i], slack[i - 1], *du[i : i + 1]]
        z = ca.vertcat(*variables)
        equalities = ca.vertcat(*a)
        jacobian = ca.jacobian(equalities, z)
        constant = ca.substitute(equalities, z, ca.SX.zeros(z.shape[0]))
        given = [x, u, dx0, reference, terminal, rows]
        cost = [ca.triu(ca.diagcat(*p)), ca.vertcat(*c)]
        dynamics = [jacobian, ca.vertcat(*b) - constant]
        clearances = ca.jacobian(ca.vertcat(*g), z)
        self._matrices = ca.Function("qp", given, [*cost, *dynamics, clearances])

    def at(self, step: RecordedStep) -> tuple[Any, ...]:
        """P, c, A, b, G, h_l, h_u, x_l, x_u of PIQP: 1/2 z'Pz + c'z, Az = b, Gz within h."""
        config, vehicle, n = self._config, self._config.vehicle, self._config.horizon
        x, u = step.iterate.x, step.iterate.u
        constraint = config.clearance_constraint
        rows = constraint.gradient(x)[1:, POSITION]
        residual = constraint.residual(x, config.tower) + step.solution.tightening.total
        reference = ocp.horizon_reference(config, step.t)
        p, c, a, b, g = self._matrices(
            x.T, u.T, step.x - x[0], reference.stages.T, reference.terminal, rows.T
        )
        # A rotor that starts outside its limits is asked only for what it can do.
        limit, rotors = vehicle.max_rotor_acceleration_hz_s, step.x[ROTORS]
        lowest = np.minimum(vehicle.min_rotor_speed_hz, rotors + limit * self._reach)
        highest = np.maximum(vehicle.max_rotor_speed_hz, rotors - limit * self._reach)
        bounds = []
        for sign, speeds, slack in ((-1.0, lowest, 0.0), (1.0, highest, np.inf)):
            free = np.full((n, ROTORS.start), sign * np.inf)
            # Of the stage after an input; the last stage has none.
            inputs = sign * limit - np.vstack([u[1:], u[:1]])
            stages = np.hstack([free, speeds - x[1:, ROTORS], np.full((n, 1), slack), inputs])
            bounds.append(np.r_[sign * limit - u[0], stages.ravel()[: -vehicle.n_rotors]])
        clearances = (g.tocsc(), np.full(n, -np.inf), -residual[1:])
        dynamics = (a.tocsc(), np.asarray(b).ravel())
        return (p.tocsc(), np.asarray(c).ravel(), *dynamics, *clearances, *bounds)
