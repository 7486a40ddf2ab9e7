"""The OCP written down a second time, for IPOPT: an independent source of truth."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model.dynamics import rk4_step, state_derivative, symbols
from gtmr_nmpc import ControllerConfig

Array = NDArray[np.float64]


def solve_with_ipopt(
    config: ControllerConfig, t: float, x0: Array, alpha: Array | None
) -> tuple[Array, Array, Array]:
    """Solve eq. (5) with margins ``alpha`` held, or eq. (15) itself where ``alpha`` is None.

    The softened clearance has the exact penalty of the configuration. Returns x_plan, u_plan and
    the slack at stages 1..N.
    """
    n, vehicle, w = config.horizon, config.vehicle, config.weights
    xs, us, zs, ws = symbols(vehicle)
    derivative = state_derivative(xs, us, zs, ws, vehicle)
    dynamics = ca.Function("f", [xs, us, zs, ws], [derivative])
    zeros9, zeros3 = ca.DM.zeros(9), ca.DM.zeros(3)
    step = rk4_step(xs, config.sampling_time_s, lambda x: dynamics(x, us, zs, zeros3))
    discrete = ca.Function("F", [xs, us, zs], [step])
    jacobians = ca.Function("J", [xs, us, zs], [ca.jacobian(step, xs), ca.jacobian(step, zs)])

    x = ca.MX.sym("x", vehicle.n_x, n + 1)
    u = ca.MX.sym("u", vehicle.n_rotors, n)
    slack = ca.MX.sym("slack", n)
    times = t + config.sampling_time_s * np.arange(n + 1)
    ref = config.helix.at(times, config.tower)
    cost = config.slack_l1 * ca.sum1(slack) + config.slack_l2 * ca.sumsqr(slack)
    gaps, clearance = [x[:, 0] - x0], []
    pi = ca.DM.zeros(vehicle.n_x, 9)

    def weighted(weights: tuple[float, ...], error: ca.MX) -> ca.MX:
        return ca.dot(ca.DM(weights), error * error)

    for i in range(n):
        acceleration = dynamics(x[:, i], u[:, i], zeros9, zeros3)[6:9]
        cost += weighted(w.position, x[:3, i] - ref.position[i])
        cost += weighted(w.velocity, x[6:9, i] - ref.velocity[i])
        cost += weighted(w.acceleration, acceleration - ref.acceleration[i])
        cost += w.roll_pitch * ca.sumsqr(x[3:5, i]) + w.yaw * (x[5, i] - ref.yaw[i]) ** 2
        cost += w.rate * ca.sumsqr(x[9:12, i] - ca.DM([0.0, 0.0, ref.yaw_rate]))
        cost += w.rotor_acceleration * ca.sumsqr(u[:, i])
        gaps.append(discrete(x[:, i], u[:, i], zeros9) - x[:, i + 1])
        p = x[:3, i + 1]
        rho = ca.sqrt(p[0] ** 2 + p[1] ** 2)
        if alpha is None:
            a, e = jacobians(x[:, i], u[:, i], zeros9)
            pi = a @ pi + e
            pi_y = ca.horzcat(-p[0] / rho, -p[1] / rho) @ pi[:2, :]
            time = config.sampling_time_s * (i + 1)
            min_mass = (1 - config.uncertainty.mass) * vehicle.mass_kg
            margin = ca.fabs(pi_y) @ ca.DM(config.uncertainty.half_widths) + config.eps_s_m
            margin += 0.5 * config.uncertainty.gust_n / min_mass * time**2
        else:
            margin = alpha[i + 1]
        y = config.tower.min_clearance_m - (rho - config.tower.radius_m)
        clearance.append(y + margin - slack[i])
    cost += weighted(w.terminal_position, x[:3, n] - ref.position[n])

    variables = ca.veccat(x, u, slack)
    constraints = ca.vertcat(*gaps, *clearance)
    n_gaps = (n + 1) * vehicle.n_x
    lower_x = np.full((n + 1, vehicle.n_x), -np.inf)
    upper_x = np.full((n + 1, vehicle.n_x), np.inf)
    lower_x[1:, 12:], upper_x[1:, 12:] = vehicle.min_rotor_speed_hz, vehicle.max_rotor_speed_hz
    limit = np.full(n * vehicle.n_rotors, vehicle.max_rotor_acceleration_hz_s)
    solver = ca.nlpsol(
        "ipopt",
        "ipopt",
        {"x": variables, "f": cost, "g": constraints},
        {
            "ipopt.tol": 1e-12,
            "ipopt.print_level": 0,
            "print_time": False,
            "ipopt.max_iter": 500,
            "ipopt.bound_relax_factor": 0.0,
        },
    )
    guess = np.r_[np.tile(x0, n + 1), np.zeros(n * vehicle.n_rotors + n)]
    result = solver(
        x0=guess,
        lbx=np.r_[lower_x.ravel(), -limit, np.zeros(n)],
        ubx=np.r_[upper_x.ravel(), limit, np.full(n, np.inf)],
        lbg=np.r_[np.zeros(n_gaps), np.full(n, -np.inf)],
        ubg=0.0,
    )
    assert solver.stats()["success"], solver.stats()["return_status"]
    flat = np.asarray(result["x"]).ravel()
    split = (n + 1) * vehicle.n_x
    return (
        flat[:split].reshape(n + 1, -1),
        flat[split : split + n * vehicle.n_rotors].reshape(n, -1),
        flat[split + n * vehicle.n_rotors :],
    )
