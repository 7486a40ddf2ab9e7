# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""One Gauss-Newton iteration of the OCP, split into preparation and feedback (Sec. V).

Preparation linearises, propagates sensitivities and condenses along the current iterate, before
the state is known; feedback embeds the measured state, solves one QP and expands its solution.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model.dynamics import POSITION, ROTORS, one_at_a_time
from gtmr_model.uncertainty import N_ZETA
from gtmr_model.vehicle import Vehicle
from gtmr_nmpc import ocp, sensitivity
from gtmr_nmpc.config import ControllerConfig, Mode
from gtmr_nmpc.margins import Iterate, PaperMargin, Tightening
from gtmr_nmpc.margins.paper import worst_vertex
from gtmr_nmpc.observer import BIAS, GUST, TORQUE, gust_decay
from gtmr_nmpc.reference.evaluate import Evaluator
from gtmr_nmpc.reference.qp import CondensedQp

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """An iterate: states and inputs over the horizon, not necessarily consistent."""

    x: Array
    """States, shape (N + 1, 12 + N_p)."""
    u: Array
    """Rotor accelerations [Hz/s], shape (N, N_p)."""


@dataclass(frozen=True)
class Preparation:
    """All of the QP that does not depend on the measured state."""

    iterate: Trajectory
    margins: Tightening
    dx_du: Array
    """Condensed dx_i/dU, shape (N + 1, n_x, N N_p)."""
    dx_dx0: Array
    """Condensed dx_i/dx_0, shape (N + 1, n_x, n_x)."""
    defect: Array
    """State offsets from the shooting gaps, shape (N + 1, n_x)."""
    hessian: Array
    """Condensed Hessian, shape (N N_p, N N_p)."""
    gradient: Array
    """Condensed gradient for dx_0 = 0, shape (N N_p,)."""
    gradient_dx0: Array
    """Its derivative with respect to dx_0, shape (N N_p, n_x)."""
    clearance_rows: Array
    """Linearised tightened clearance of stages 1..N, shape (N, N N_p)."""
    clearance_residual: Array
    """Its value for dU = 0, dx_0 = 0 [m], shape (N,)."""
    clearance_dx0: Array
    """Its derivative with respect to dx_0, shape (N, n_x)."""


class RealTimeIteration:
    """Prepares and solves the Gauss-Newton QPs of one problem."""

    def __init__(self, config: ControllerConfig) -> None:
        n, vehicle = config.horizon, config.vehicle
        functions = _functions(vehicle, config.sampling_time_s)
        self._dynamics = functions.dynamics
        self._linearise = Evaluator(functions.linearise, n)
        self._linearise_with_zeta = Evaluator(functions.linearise_with_zeta, n)
        self._disturbed_dynamics = functions.disturbed_dynamics
        self._linearise_disturbed = Evaluator(functions.linearise_disturbed, n)
        self._disturbance: Array | None = None
        self._adjoint = Evaluator(functions.adjoint, n * (n + 1) // 2)
        ones = np.tril(np.ones((n, n)))
        speed_rows = config.sampling_time_s * np.kron(ones, np.eye(vehicle.n_rotors))
        self._speed_rows = np.asarray(speed_rows, dtype=float)
        self.reconfigure(config)

    def reconfigure(self, config: ControllerConfig) -> None:
        """Take over other numbers of the same problem, of the same vehicle, horizon and T_s.

        What is compiled does not depend on them.
        """
        self.config = config
        self._sqrt_q = np.sqrt(ocp.stage_weights(config))
        self._sqrt_qf = np.sqrt(config.weights.terminal_position)

    def disturb(self, theta: Array | None) -> None:
        """Let disturbances, shape (9,), act in the model from now on; None for none."""
        self._disturbance = None
        if theta is not None:
            left = gust_decay(self.config) ** np.arange(self.config.horizon)
            force = theta[BIAS] + left[:, None] * theta[GUST]
            self._disturbance = np.hstack([force, np.tile(theta[TORQUE], (len(left), 1))])

    def predict(self, x: Array, u: Array, stage: int = 0) -> Array:
        """Simulate one stage, eq. (5b): x (12 + N_p,), u (N_p,) [Hz/s]."""
        if self._disturbance is not None:
            force, torque = np.split(self._disturbance[stage], 2)
            return np.asarray(
                self._disturbed_dynamics(x, u, np.zeros(N_ZETA), force, torque)
            ).ravel()
        return np.asarray(self._dynamics(x, u, np.zeros(N_ZETA))).ravel()

    def sensitivities(self, iterate: Trajectory) -> Array:
        """Pi along an iterate, eq. (8), shape (N + 1, 12 + N_p, 9)."""
        _, a, _, _, _, e = self._linearised(iterate, with_zeta=True)
        return sensitivity.propagate(a, e)

    def _linearised(self, iterate: Trajectory, with_zeta: bool) -> list[Array]:
        x, u = iterate.x[:-1], iterate.u
        if self._disturbance is not None:
            return self._linearise_disturbed(x, u, *np.split(self._disturbance, 2, axis=1))
        return (self._linearise_with_zeta if with_zeta else self._linearise)(x, u)

    def margin_gradient(self, iterate: Trajectory) -> tuple[Array, Array]:
        """Gradient of alpha_p along an iterate, away from sign changes of Pi_y.

        d alpha_p,i / d x_k, shape (N + 1, N + 1, 12 + N_p), and d alpha_p,i / d u_k, shape (N + 1,
        N, N_p).
        """
        _, a, _, _, _, e = self._linearise_with_zeta(iterate.x[:-1], iterate.u)
        return self._margin_gradient(iterate, a, sensitivity.propagate(a, e))

    def prepare(
        self, t: float, iterate: Trajectory, mode: Mode, margin_scale: float = 1.0
    ) -> Preparation:
        """Linearise and condense along an iterate whose stage 0 is at t [s].

        In robust mode the margins are scaled by 0 to 1.
        """
        n, n_x, n_u = self.config.horizon, self.config.vehicle.n_x, self.config.vehicle.n_rotors
        robust = mode == "robust"
        x_next, a, b, h, dh, *rest = self._linearised(iterate, with_zeta=robust)

        dx_du = np.zeros((n + 1, n_x, n * n_u))
        dx_dx0 = np.zeros((n + 1, n_x, n_x))
        dx_dx0[0] = np.eye(n_x)
        defect = np.zeros((n + 1, n_x))
        for i in range(n):
            past = i * n_u
            dx_du[i + 1, :, :past] = a[i] @ dx_du[i, :, :past]
            dx_du[i + 1, :, past : past + n_u] = b[i]
            dx_dx0[i + 1] = a[i] @ dx_dx0[i]
            defect[i + 1] = a[i] @ defect[i] + x_next[i] - iterate.x[i + 1]

        # The cost as least squares, ||residual + J_u dU + J_x dx_0||^2, stage 0 being given.
        reference = ocp.horizon_reference(self.config, t)
        output = dh * self._sqrt_q[..., None]

        def weighed(dx: Array) -> Array:
            """Rows of the least squares that changes of the states make, one a column."""
            stages = (output[1:] @ dx[1:-1]).reshape(-1, dx.shape[2])
            return np.vstack([stages, self._sqrt_qf[:, None] * dx[-1, POSITION]])

        stage = self._sqrt_q * (h - reference.stages)
        terminal = self._sqrt_qf * (iterate.x[-1, POSITION] - reference.terminal)
        residual = np.r_[stage[1:].ravel(), terminal] + weighed(defect[..., None])[:, 0]
        j_u, j_x = weighed(dx_du), weighed(dx_dx0)
        q_u = self.config.weights.rotor_acceleration
        hessian = 2.0 * (j_u.T @ j_u)
        hessian[np.diag_indices_from(hessian)] += 2.0 * q_u

        constraint = self.config.clearance_constraint
        # By position alone, the attitude being the iterate's: with the attitude's part too, a wind
        # that never ends makes the vehicle tip over to keep its discs away.
        gradient_y = constraint.gradient(iterate.x)[:, POSITION]
        rows = np.einsum("ij,ijk->ik", gradient_y, dx_du[:, POSITION])
        rows_dx0 = np.einsum("ij,ijk->ik", gradient_y, dx_dx0[:, POSITION])
        offset = np.einsum("ij,ij->i", gradient_y, defect[:, POSITION])
        if robust:
            pi = sensitivity.propagate(a, rest[0])
            told = Iterate(self.config, iterate.x, iterate.u, lambda: pi)
            tightening = PaperMargin().tightening(told).scaled(margin_scale)
            if self.config.tightening == "gradient":
                d_x, d_u = self._margin_gradient(iterate, a, pi)
                d_x_flat = margin_scale * d_x.reshape(n + 1, -1)
                d_u_flat = margin_scale * d_u.reshape(n + 1, -1)
                rows += d_x_flat @ dx_du.reshape(-1, n * n_u) + d_u_flat
                rows_dx0 += d_x_flat @ dx_dx0.reshape(-1, n_x)
                offset += d_x_flat @ defect.ravel()
        else:
            tightening = Tightening.constant(np.zeros(n + 1))
        tightened = constraint.residual(iterate.x, self.config.tower) + tightening.total
        return Preparation(
            iterate=iterate,
            margins=tightening,
            dx_du=dx_du,
            dx_dx0=dx_dx0,
            defect=defect,
            hessian=hessian,
            gradient=2.0 * (j_u.T @ residual + q_u * iterate.u.ravel()),
            gradient_dx0=2.0 * (j_u.T @ j_x),
            clearance_rows=rows[1:],
            clearance_residual=(tightened + offset)[1:],
            clearance_dx0=rows_dx0[1:],
        )

    def feedback(self, prep: Preparation, x: Array) -> tuple[Trajectory, Array] | None:
        """Embed the measured state, shape (12 + N_p,), solve the QP, take the full step.

        The preparation is for the time of x, whose yaw is within pi of the iterate's. Gives the
        new iterate and the slack of stages 1..N [m]; None if the QP solver gave up.
        """
        solution = self.condensed(prep, x).solve()
        if solution is None:
            return None
        dx0 = x - prep.iterate.x[0]
        dx = prep.dx_du @ solution.du + prep.dx_dx0 @ dx0 + prep.defect
        du = solution.du.reshape(self.config.horizon, -1)
        return Trajectory(x=prep.iterate.x + dx, u=prep.iterate.u + du), solution.slack

    def condensed(self, prep: Preparation, x: Array) -> CondensedQp:
        """State the QP for the measured state, shape (12 + N_p,), with arguments of `feedback`."""
        n, vehicle = self.config.horizon, self.config.vehicle
        dx0 = x - prep.iterate.x[0]
        u = prep.iterate.u.ravel()
        limit = vehicle.max_rotor_acceleration_hz_s

        # A rotor that starts outside its limits is asked only for what it can do.
        reach = limit * self.config.sampling_time_s * np.arange(1, n + 1)[:, None]
        lowest = np.minimum(vehicle.min_rotor_speed_hz, x[ROTORS] + reach)
        highest = np.maximum(vehicle.max_rotor_speed_hz, x[ROTORS] - reach)
        planned = x[ROTORS] + (self._speed_rows @ u).reshape(n, -1)

        return CondensedQp(
            hessian=prep.hessian,
            gradient=prep.gradient + prep.gradient_dx0 @ dx0,
            input_lower=-limit - u,
            input_upper=limit - u,
            speed_rows=self._speed_rows,
            speed_lower=(lowest - planned).ravel(),
            speed_upper=(highest - planned).ravel(),
            clearance_rows=prep.clearance_rows,
            clearance_upper=-(prep.clearance_residual + prep.clearance_dx0 @ dx0),
            slack_l1=self.config.slack_l1,
            slack_l2=self.config.slack_l2,
        )

    def _margin_gradient(self, iterate: Trajectory, a: Array, pi: Array) -> tuple[Array, Array]:
        """Differentiate alpha_p,i = J_yx(x_i) Pi_i s_i with the signs s_i held."""
        n, n_x, n_u = self.config.horizon, self.config.vehicle.n_x, self.config.vehicle.n_rotors
        constraint = self.config.clearance_constraint
        gradient_y, states = constraint.gradient(iterate.x), slice(constraint.length)
        pi_y = sensitivity.clearance_sensitivity(iterate.x, pi, constraint)
        signs = worst_vertex(pi_y, self.config.uncertainty)
        margin, step = np.tril_indices(n)
        margin = margin + 1
        # lambda of step k for margin i: J_yx carried back from stage i to stage k + 1.
        lam = np.zeros((n + 1, n, n_x))
        back = np.zeros((n + 1, n_x))
        for k in range(n - 1, -1, -1):
            back = back @ a[k + 1] if k + 1 < n else back
            back[k + 1, states] = gradient_y[k + 1]
            lam[:, k] = back
        direction = np.einsum("kxj,ij->ikx", pi, signs)
        (gradient,) = self._adjoint(
            iterate.x[step],
            iterate.u[step],
            lam[margin, step],
            direction[margin, step],
            signs[margin],
        )
        d_x, d_u = np.zeros((n + 1, n + 1, n_x)), np.zeros((n + 1, n, n_u))
        d_x[margin, step] = gradient[:, :n_x]
        d_u[margin, step] = gradient[:, n_x:]
        stages = np.arange(n + 1)
        d_x[stages, stages, states] += constraint.curvature(iterate.x, direction[stages, stages])
        return d_x, d_u


class _Functions(NamedTuple):
    dynamics: ca.Function
    disturbed_dynamics: ca.Function
    linearise: ca.Function
    linearise_with_zeta: ca.Function
    linearise_disturbed: ca.Function
    adjoint: ca.Function


@lru_cache(maxsize=64)
@one_at_a_time
def _functions(vehicle: Vehicle, sampling_time_s: float) -> _Functions:
    """Make what is evaluated; it is kept, so that no thread drops expressions."""
    config = ControllerConfig(vehicle=vehicle, sampling_time_s=sampling_time_s)
    dynamics = ocp.discrete_dynamics(config)
    return _Functions(
        dynamics,
        ocp.disturbed_dynamics(config),
        _linearisation(config, with_zeta=False),
        _linearisation(config, with_zeta=True),
        _linearisation(config, with_zeta=True, disturbed=True),
        sensitivity.second_order_adjoint(dynamics),
    )


def _linearisation(
    config: ControllerConfig, with_zeta: bool, disturbed: bool = False
) -> ca.Function:
    """One stage: (x, u) -> F, dF/dx, dF/du, h, dh/dx and, where asked, dF/dzeta at zeta = 0.

    Disturbed, it takes force and torque as well.
    """
    dynamics = ocp.disturbed_dynamics(config) if disturbed else ocp.discrete_dynamics(config)
    output = ocp.output_map(config)
    x, u, zeta, *theta = (
        ca.SX.sym(dynamics.name_in(i), dynamics.size1_in(i)) for i in range(dynamics.n_in())
    )
    x_next, h = dynamics(x, u, zeta, *theta), output(x)
    if disturbed:
        h[6:9] += theta[0] / config.vehicle.mass_kg
    results = [x_next, ca.jacobian(x_next, x), ca.jacobian(x_next, u), h, ca.jacobian(h, x)]
    if with_zeta:
        results.append(ca.jacobian(x_next, zeta))
    results = ca.substitute(results, [zeta], [ca.DM.zeros(N_ZETA)])
    return ca.Function("linearise", [x, u, *theta], [ca.densify(r) for r in results])
