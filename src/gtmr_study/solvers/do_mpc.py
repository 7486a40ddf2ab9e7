# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The nominal problem in do-mpc, as a user of that library would state it."""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model import N_ZETA
from gtmr_model.dynamics import ROTORS, VELOCITY, discrete_step, state_derivative
from gtmr_nmpc import ControllerConfig
from gtmr_study.solvers.nlp import NlpSolution, references, stage_cost, terminal_cost

Array = NDArray[np.float64]


class DoMpcRival:
    """Eq. (5) in do-mpc with IPOPT; the clearance is its soft constraint, with L1 penalty only.

    ModuleNotFoundError if do-mpc is not installed.
    """

    def __init__(self, config: ControllerConfig) -> None:
        import do_mpc

        self._t, vehicle = 0.0, config.vehicle
        tower = config.tower
        no_zeta, no_gust = ca.DM.zeros(N_ZETA), ca.DM.zeros(3)
        model: Any = do_mpc.model.Model("discrete", "SX")
        x = model.set_variable("_x", "x", (vehicle.n_x, 1))
        u = model.set_variable("_u", "u", (vehicle.n_rotors, 1))
        r = model.set_variable("_tvp", "reference", (10, 1))

        x_next = discrete_step(x, u, no_zeta, no_gust, vehicle, config.sampling_time_s)
        model.set_rhs("x", x_next)
        model.setup()

        acceleration = state_derivative(x, u, no_zeta, no_gust, vehicle)[VELOCITY]
        mpc: Any = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon = config.horizon
        mpc.settings.t_step = config.sampling_time_s
        mpc.settings.store_full_solution = False
        mpc.settings.nlpsol_opts = {"ipopt.tol": 1e-6}
        mpc.settings.supress_ipopt_output()
        mpc.set_objective(
            lterm=stage_cost(config, x, u, acceleration, r), mterm=terminal_cost(config, x, r)
        )
        rho = ca.sqrt(x[0] ** 2 + x[1] ** 2)
        mpc.set_nl_cons(
            "clearance",
            tower.min_clearance_m + tower.radius_m - rho,
            ub=0.0,
            soft_constraint=True,
            penalty_term_cons=config.slack_l1,
        )
        for bound, free, rotors_hz in (
            ("lower", -np.inf, vehicle.min_rotor_speed_hz),
            ("upper", np.inf, vehicle.max_rotor_speed_hz),
        ):
            limits = np.full(vehicle.n_x, free)
            limits[ROTORS] = rotors_hz
            mpc.bounds[bound, "_x", "x"] = limits
        mpc.bounds["lower", "_u", "u"] = -vehicle.max_rotor_acceleration_hz_s
        mpc.bounds["upper", "_u", "u"] = vehicle.max_rotor_acceleration_hz_s
        template = mpc.get_tvp_template()

        def ahead(_: Any) -> Any:
            for k, row in enumerate(references(config, self._t)):
                template["_tvp", k, "reference"] = row
            return template

        mpc.set_tvp_fun(ahead)
        mpc.setup()
        self._mpc = mpc

    def solve(
        self, t: float, x0: Array, alpha: Array | None, guess: NlpSolution | None
    ) -> NlpSolution:
        """Solve for one measured state as `InspectionNlp.solve` does; ``alpha`` is not used.

        The solution has the first input only, which is what do-mpc gives. With a ``guess`` it
        starts from its own last solution.
        """
        self._t = t
        if guess is None:
            self._mpc.x0 = x0
            self._mpc.set_initial_guess()
        u = np.asarray(self._mpc.make_step(x0[:, None])).T
        cost = float(self._mpc.solver_stats["iterations"]["obj"][-1])
        return NlpSolution(x=x0[None, :], u=u, slack=np.zeros(0), cost=cost)
