# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The nominal problem in do-mpc, as a user of that library would state it."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model import N_ZETA
from gtmr_model.dynamics import (
    ATTITUDE,
    POSITION,
    RATE,
    ROTORS,
    VELOCITY,
    discrete_step,
    state_derivative,
)
from gtmr_nmpc import ControllerConfig
from gtmr_study.rivals.nlp import Plan

Array = NDArray[np.float64]


class DoMpcRival:
    """Eq. (5) in do-mpc with IPOPT; the clearance is its soft constraint, with L1 penalty only.

    Parameters
    ----------
    config : ControllerConfig
        The problem.

    Raises
    ------
    ModuleNotFoundError
        If do-mpc is not installed.
    """

    def __init__(self, config: ControllerConfig) -> None:
        import do_mpc

        self._config, self._t, vehicle = config, 0.0, config.vehicle
        w, tower = config.weights, config.tower
        no_zeta, no_gust = ca.DM.zeros(N_ZETA), ca.DM.zeros(3)
        model: Any = do_mpc.model.Model("discrete", "SX")
        x = model.set_variable("_x", "x", (vehicle.n_x, 1))
        u = model.set_variable("_u", "u", (vehicle.n_rotors, 1))
        r = model.set_variable("_tvp", "reference", (10, 1))

        def derivative(state: Any) -> Any:
            return state_derivative(state, u, no_zeta, no_gust, vehicle)

        x_next = discrete_step(x, u, no_zeta, no_gust, vehicle, config.sampling_time_s)
        model.set_rhs("x", x_next)
        model.setup()

        def weighted(weights: tuple[float, ...], error: Any) -> Any:
            return ca.dot(ca.DM(weights), error * error)

        yaw_rate = config.helix.at(0.0, tower).yaw_rate[0]
        stage = (
            weighted(w.position, x[POSITION] - r[0:3])
            + weighted(w.velocity, x[VELOCITY] - r[3:6])
            + weighted(w.acceleration, derivative(x)[VELOCITY] - r[6:9])
            + w.roll_pitch * ca.sumsqr(x[ATTITUDE][:2])
            + w.yaw * (x[ATTITUDE][2] - r[9]) ** 2
            + w.rate * ca.sumsqr(x[RATE] - ca.DM([0.0, 0.0, yaw_rate]))
            + w.rotor_acceleration * ca.sumsqr(u)
        )
        mpc: Any = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon = config.horizon
        mpc.settings.t_step = config.sampling_time_s
        mpc.settings.store_full_solution = False
        mpc.settings.nlpsol_opts = {"ipopt.tol": 1e-6}
        mpc.settings.supress_ipopt_output()
        mpc.set_objective(lterm=stage, mterm=weighted(w.terminal_position, x[POSITION] - r[0:3]))
        rho = ca.sqrt(x[0] ** 2 + x[1] ** 2)
        mpc.set_nl_cons(
            "clearance",
            tower.min_clearance_m + tower.radius_m - rho,
            ub=0.0,
            soft_constraint=True,
            penalty_term_cons=config.slack_l1,
        )
        lower = np.full(vehicle.n_x, -np.inf)
        lower[ROTORS] = vehicle.min_rotor_speed_hz
        mpc.bounds["lower", "_x", "x"] = lower
        upper = np.full(vehicle.n_x, np.inf)
        upper[ROTORS] = vehicle.max_rotor_speed_hz
        mpc.bounds["upper", "_x", "x"] = upper
        mpc.bounds["lower", "_u", "u"] = -vehicle.max_rotor_acceleration_hz_s
        mpc.bounds["upper", "_u", "u"] = vehicle.max_rotor_acceleration_hz_s
        template = mpc.get_tvp_template()

        def references(_: Any) -> Any:
            times = self._t + config.sampling_time_s * np.arange(config.horizon + 1)
            at = config.helix.at(times, tower)
            rows = np.hstack([at.position, at.velocity, at.acceleration, at.yaw[:, None]])
            for k, row in enumerate(rows):
                template["_tvp", k, "reference"] = row
            return template

        mpc.set_tvp_fun(references)
        mpc.setup()
        self._mpc = mpc

    def solve(self, t: float, x0: Array, alpha: Array | None, guess: Plan | None) -> Plan:
        """Solve for one measured state; the signature is that of `InspectionNlp.solve`.

        Parameters
        ----------
        t : float
            Time of stage 0 [s].
        x0 : NDArray, shape (12 + N_p,)
            Measured state.
        alpha : NDArray or None
            Not used: the problem is nominal.
        guess : Plan or None
            None to start from the state held over the horizon, else from the last solution.

        Returns
        -------
        Plan
            Its plan is empty: do-mpc gives the first input only.
        """
        self._t = t
        if guess is None:
            self._mpc.x0 = x0
            self._mpc.set_initial_guess()
        u = np.asarray(self._mpc.make_step(x0[:, None])).T
        cost = float(self._mpc.solver_stats["iterations"]["obj"][-1])
        return Plan(x=x0[None, :], u=u, slack=np.zeros(0), cost=cost)
