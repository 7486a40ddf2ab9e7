# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The loop of plant, observer and controller, linearised about hover beside the tower.

While no inequality is active the controller is linear, and what gusts, noise and mismatch do to
the clearance is read off the responses of this loop. The lead is assumed to cancel the lag of the
motors, and a delay is rounded up to whole steps.
"""

import itertools
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gtmr_model.dynamics import (
    ATTITUDE,
    POSITION,
    RATE,
    ROTORS,
    VELOCITY,
    discrete_step,
    one_at_a_time,
    symbols,
)
from gtmr_model.uncertainty import N_ZETA
from gtmr_model.vehicle import Vehicle
from gtmr_nmpc import ocp
from gtmr_nmpc.config import ControllerConfig, Mode
from gtmr_nmpc.margins import Deviations
from gtmr_nmpc.observer import BIAS, GUST, N_THETA, TORQUE, gains, gust_decay

Array = NDArray[np.float64]

RESPONSE_STEPS = 320
"""How long responses are followed, in steps: 8 s of the paper's."""
NEGLIGIBLE_M = 2e-5
"""Below this a transient is over [m]."""
DIGITS = 12
"""Decimals of a margin in m."""
BODY = slice(0, ROTORS.start)


@dataclass(frozen=True)
class _Model:
    """One step about hover: x_next = a x + b u + e_force f + e_torque tau + e_zeta zeta."""

    a: Array
    b: Array
    e_force: Array
    e_torque: Array
    e_zeta: Array


@dataclass(frozen=True)
class _Plan:
    """The unconstrained plan: u_0 and the radial positions of all stages from x and theta."""

    u_x: Array
    """Shape (N_p, n_x)."""
    u_theta: Array
    """Shape (N_p, 9)."""
    radial_x: Array
    """Shape (N + 1, n_x)."""
    radial_theta: Array
    """Shape (N + 1, 9)."""


@dataclass(frozen=True)
class Responses:
    """Radial deviations, positive away from the tower, after an excitation that begins at 0."""

    radial: Array
    """Of the flight [m], shape (K, columns)."""
    from_plan: Array
    """Of the flight from the plan made i steps before, at every step k >= 0 and, in rows before
    that, from plans made before the excitation: entry [N + k, i] is for the plan made at step k
    >= -N [m], shape (K, N + 1, columns)."""


def _hover(config: ControllerConfig, zeta: Array) -> Array:
    x = config.helix.initial_state(config.tower, config.vehicle)
    x[VELOCITY] = 0.0
    x[RATE] = 0.0
    x[ROTORS] *= np.sqrt((1.0 + zeta[0]) / (1.0 + zeta[4]))
    return x


@lru_cache(maxsize=8)
@one_at_a_time
def _linearisation(vehicle: Vehicle, step_s: float) -> ca.Function:
    x, u, zeta, force = symbols(vehicle)
    torque = ca.SX.sym("torque", 3)
    step = discrete_step(x, u, zeta, force, vehicle, step_s, torque)
    jacobians = [ca.densify(ca.jacobian(step, of)) for of in (x, u, force, torque, zeta)]
    return ca.Function("about_hover", [x, u, zeta, force, torque], jacobians)


@lru_cache(maxsize=8)
@one_at_a_time
def _output_jacobian(vehicle: Vehicle) -> ca.Function:
    h, x = ocp.output_map(ControllerConfig(vehicle=vehicle)), ca.SX.sym("x", vehicle.n_x)
    return ca.Function("dh", [x], [ca.densify(ca.jacobian(h(x), x))])


def _model(config: ControllerConfig, zeta: Array) -> _Model:
    x, u = _hover(config, zeta), np.zeros(config.vehicle.n_rotors)
    about = _linearisation(config.vehicle, config.sampling_time_s)
    jacobians = about(x, u, zeta, np.zeros(3), np.zeros(3))
    return _Model(*(np.asarray(jacobian) for jacobian in jacobians))


def _theta_input(model: _Model) -> Array:
    """Input matrix of theta: b and g as a force, tau as a torque, shape (n_x, 9)."""
    return np.hstack([model.e_force, model.e_force, model.e_torque])


def _decay(config: ControllerConfig) -> Array:
    """Share of theta that is left after a step, shape (9,)."""
    decay = np.ones(N_THETA)
    decay[GUST] = gust_decay(config)
    return decay


def _radial(config: ControllerConfig) -> Array:
    start = config.helix.initial_state(config.tower, config.vehicle)
    return np.asarray(-config.clearance_constraint.gradient(start[None])[0])


@lru_cache(maxsize=4)
def _plan(config: ControllerConfig) -> _Plan:
    """Solve the problem without inequalities, about hover and the reference."""
    radial = _radial(config)
    n, n_x, n_u = config.horizon, config.vehicle.n_x, config.vehicle.n_rotors
    model = _model(config, np.zeros(N_ZETA))
    x_hover = _hover(config, np.zeros(N_ZETA))
    dh = np.asarray(_output_jacobian(config.vehicle)(x_hover))
    h_force = np.zeros((ocp.N_H, 3))
    h_force[6:9] = np.eye(3) / config.vehicle.mass_kg
    h_theta = np.hstack([h_force, h_force, np.zeros((ocp.N_H, 3))])

    # States of the horizon as rows of [x_0 theta U].
    first_u = n_x + N_THETA
    states = np.zeros((n + 1, n_x, first_u + n * n_u))
    states[0, :, :n_x] = np.eye(n_x)
    forecast = np.eye(N_THETA)
    sqrt_q, rows = np.sqrt(ocp.stage_weights(config)), []
    for i in range(n):
        if i > 0:
            row = dh @ states[i]
            row[:, n_x:first_u] += h_theta @ forecast
            rows.append(sqrt_q[:, None] * row)
        states[i + 1] = model.a @ states[i]
        states[i + 1, :, n_x:first_u] += _theta_input(model) @ forecast
        at = first_u + i * n_u
        states[i + 1, :, at : at + n_u] += model.b
        forecast = _decay(config)[:, None] * forecast
    rows.append(np.sqrt(config.weights.terminal_position)[:, None] * states[n, POSITION])
    cost = np.vstack(rows)
    j_u, j_given = cost[:, first_u:], cost[:, :first_u]
    hessian = j_u.T @ j_u + config.weights.rotor_acceleration * np.eye(n * n_u)
    inputs = -np.linalg.solve(hessian, j_u.T @ j_given)
    planned = radial @ states[:, : len(radial)]
    by_given = planned[:, :first_u] + planned[:, first_u:] @ inputs
    return _Plan(
        u_x=inputs[:n_u, :n_x],
        u_theta=inputs[:n_u, n_x:],
        radial_x=by_given[:, :n_x],
        radial_theta=by_given[:, n_x:],
    )


@dataclass(frozen=True)
class _Excitation:
    """What happens from step 0 on; one column each."""

    push: Array
    """Added to the state at the end of step 0, shape (n_x, columns)."""
    steady: Array
    """Added to it at the end of every step, shape (n_x, columns)."""
    noise: Array
    """Added to the measurement at step 0, shape (12, columns)."""


class ClosedLoop:
    """The loop of a mode, with the plant's zeta; nothing is excited before step 0."""

    def __init__(self, config: ControllerConfig, mode: Mode, zeta: Array) -> None:
        self._observes = mode == "offset_free"
        own = {"weights": config.offset_free.weights} if self._observes else {}
        self._config = config = config.model_copy(update=own)
        self.radial: Array = _radial(config)
        """Gradient of the clearance at the start of the reference, away from the tower, in the
        states that it depends on: p, and eta for the airframe, shape (3,) or (6,)."""
        self._plant = _model(config, zeta)
        self._believed = _model(config, np.zeros(N_ZETA))
        self._plan = _plan(config)
        # Rounded up: later is the cautious side.
        self._delay = math.ceil(config.delay_s / config.sampling_time_s - 1e-9)

    def gusts(self) -> Responses:
        """Respond to a gust of 1 N along x, y and z, held for one step."""
        n_x = self._config.vehicle.n_x
        nothing = np.zeros((n_x, 3))
        return self._run(_Excitation(self._plant.e_force, nothing, np.zeros((12, 3))))

    def noise(self) -> Responses:
        """Respond to one wrong measurement, by 1 in each of p, eta, v and omega."""
        nothing = np.zeros((self._config.vehicle.n_x, 12))
        return self._run(_Excitation(nothing, nothing, np.eye(12)))

    def mismatch(self) -> Responses:
        """Respond to each channel of zeta, 1 from step 0 on, not known then."""
        nothing = np.zeros((self._config.vehicle.n_x, N_ZETA))
        return self._run(_Excitation(nothing, self._plant.e_zeta, np.zeros((12, N_ZETA))))

    def _run(self, excitation: _Excitation) -> Responses:
        n_x, columns = excitation.push.shape
        advance, disturb = self._matrices
        state = np.zeros((self._size, columns))
        told = np.zeros((RESPONSE_STEPS, len(advance) - self._size, columns))
        for k in range(RESPONSE_STEPS):
            after = advance @ state
            if k == self._delay:
                after += disturb @ excitation.noise
            state, told[k] = np.split(after, [self._size])
            state[:n_x] += excitation.steady
            if k == 0:
                state[:n_x] += excitation.push
        return self._responses(told[:, 0], told[:, 1:])

    @property
    def _size(self) -> int:
        """Length of the loop's state: x now and as far back as the delay, inputs, estimates."""
        n_x, n_u = self._config.vehicle.n_x, self._config.vehicle.n_rotors
        return n_x * (1 + self._delay) + n_u * self._delay + BODY.stop + N_THETA

    @cached_property
    def _matrices(self) -> tuple[Array, Array]:
        """Map of a step, from the loop's state and from the noise in a measurement.

        Its rows are the next state, the radial deviation of now, and those of the plan.
        """
        still, quiet = np.zeros((self._size, BODY.stop)), np.zeros((BODY.stop, self._size))
        return self._step(np.eye(self._size), quiet), self._step(still, np.eye(BODY.stop))

    def _step(self, state: Array, noise: Array) -> Array:
        config, plan, believed = self._config, self._plan, self._believed
        n_x, n_u, late = config.vehicle.n_x, config.vehicle.n_rotors, self._delay
        ends = np.cumsum([n_x] * (1 + late) + [n_u] * late + [BODY.stop])
        parts = np.split(state, ends)
        # Newest first: what was there and was done since the measurement that arrives now.
        past_x, past_u, (estimate, theta) = parts[: 1 + late], parts[1 + late : -2], parts[-2:]
        x, measured, known = past_x[0], past_x[-1].copy(), theta
        measured[BODY] += noise
        now = measured
        if self._observes:
            estimate, theta = self._correct(estimate, theta, measured[BODY])
            now = np.vstack([estimate, measured[ROTORS]])
        for sent in reversed(past_u):
            now = believed.a @ now + believed.b @ sent + _theta_input(believed) @ theta
        planned = plan.radial_x @ now + plan.radial_theta @ known
        command = plan.u_x @ now + plan.u_theta @ known
        if self._observes:
            # To the next measurement, by the input that acted then.
            at, acted = np.vstack([estimate, measured[ROTORS]]), [command, *past_u][-1]
            moved = believed.a @ at + believed.b @ acted + _theta_input(believed) @ theta
            estimate, theta = moved[BODY], _decay(config)[:, None] * theta
        x_next = self._plant.a @ x + self._plant.b @ command
        told = [(self.radial @ x[: len(self.radial)])[None], planned]
        return np.vstack(
            [x_next, *past_x[:late], *[command, *past_u][:late], estimate, theta, *told]
        )

    def _correct(self, x: Array, theta: Array, measured: Array) -> tuple[Array, Array]:
        by = gains(self._config)
        inertia = np.array(self._config.vehicle.inertia_kg_m2)[:, None]
        off = measured - x
        parts = [g[0] * off[POSITION] + g[1] * off[VELOCITY] for g in by.translation]
        turns = [g[0] * off[ATTITUDE] + g[1] * off[RATE] for g in by.rotation]
        x, theta = x.copy(), theta.copy()
        for where, part in ((POSITION, parts[0]), (VELOCITY, parts[1])):
            x[where] += part
        for where, part in ((ATTITUDE, turns[0]), (RATE, turns[1])):
            x[where] += part
        theta[BIAS] += parts[2]
        theta[GUST] += parts[3]
        theta[TORQUE] += inertia * turns[2]
        return x, theta

    def _responses(self, radial: Array, planned: Array) -> Responses:
        n, (steps, columns) = self._config.horizon, radial.shape
        flown = np.vstack([np.zeros((n, columns)), radial])
        plans = np.vstack([np.zeros((n, n + 1, columns)), planned])
        from_plan = np.zeros((steps, n + 1, columns))
        for i in range(n + 1):
            from_plan[:, i] = flown[i : i + steps] - plans[:steps, i]
        return Responses(radial=radial, from_plan=from_plan)


def _corners(config: ControllerConfig) -> list[Array]:
    """Vehicles between which the loop's gain is largest: mass and thrust at their bounds."""
    zetas = []
    for mass, thrust in itertools.product((-1.0, 1.0), repeat=2):
        zeta = np.zeros(N_ZETA)
        zeta[0], zeta[4] = mass * config.uncertainty.mass, thrust * config.uncertainty.thrust
        zetas.append(zeta)
    return zetas


@lru_cache(maxsize=16)
def deviations(config: ControllerConfig) -> Deviations:
    """Bound what the mode ``offset_free`` may deviate from its plans, over mass and thrust."""
    noise = config.offset_free.noise
    sigma = np.repeat(
        [noise.position_m, noise.attitude_rad, noise.velocity_m_s, noise.rate_rad_s], 3
    )
    gust, spread, transient = [], [], []
    n = config.horizon
    for zeta in _corners(config):
        loop = ClosedLoop(config, "offset_free", zeta)
        pushed = np.linalg.norm(loop.gusts().from_plan, axis=2)
        gust.append(config.uncertainty.gust_n * pushed.sum(axis=0))
        spread.append(np.sqrt(((loop.noise().from_plan * sigma) ** 2).sum(axis=(0, 2))))
        settled = loop.mismatch().from_plan[n:] * config.uncertainty.half_widths
        transient.append(np.abs(settled))
    worst = np.max(transient, axis=0)
    after = np.nonzero(worst.sum(axis=2).max(axis=1) > NEGLIGIBLE_M)[0]
    lasts = int(after[-1]) + 1 if after.size else 1
    # Rounded, so that they do not depend on how many threads multiply matrices.
    return Deviations(
        gust=np.max(gust, axis=0).round(DIGITS),
        noise=np.max(spread, axis=0).round(DIGITS),
        transient=worst[:lasts].round(DIGITS),
    )


def l1_sequence(config: ControllerConfig, mode: Mode) -> tuple[float, ...]:
    """Find the gusts that drive a mode closest to the tower, step by step, each 1 or -1.

    Positive is towards the tower. By the last step the whole of the loop's impulse response has
    been used, sign by sign: no sequence within the same bound does more to a linear loop.
    """
    loop = ClosedLoop(config, mode, np.zeros(N_ZETA))
    radial = loop.gusts().radial[1:] @ loop.radial[POSITION]
    # At its end the response is rounding, and so are its signs.
    counts = np.abs(radial) > 1e-9 * np.abs(radial).max()
    return tuple(np.where(counts & (radial < 0.0), -1.0, 1.0)[::-1].tolist())
