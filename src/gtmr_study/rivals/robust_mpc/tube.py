# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Rigid tube MPC: a plan of the undisturbed vehicle, and feedback that keeps the real one near it.

The nominal state z flies by itself, z_{k+1} = F(z_k, v_k), its NMPC tightened by a constant
cross-section; the vehicle gets u = v + K (x - z) (Mayne, Seron, Rakovic, Automatica 2005). K is
the LQR of the QP's own weights, turned with the vehicle. The cross-section is computed once,
offline: the support of all that the error can reach from zero in the clearance, the rotors'
speeds and their accelerations.

What it assumes: the error's dynamics are those about hover at every point of the path, and what
zeta does is additive. zeta is constant: its part is the largest value of the step response, which
is what an invariant set of the error augmented with zeta holds. Gusts are any sequence within
their bound: their part is the L1 norm of the impulse response, the support of the minimal robust
positive invariant set. Wind from any side is taken as a disc around its box, since the frame that
faces the tower turns. Noise counts with three standard deviations, and late odometry as what the
prediction over the delay misses.

How tuned: by four factors of the paper's cost, for each world. What it costs: 0.16 ms a step, a
nominal one and a product of a matrix and a vector.

Where it breaks: the plan knows nothing of what happens, so that a steady wind leaves a steady
offset, and the cross-section stands off from it always. Gusts and mismatch together take most of
the rotors' acceleration: with stiffer feedback than this nothing is left for the plan, which then
keeps three tenths of every limit and the tube is no proof. Where the error leaves the linear
range, or a world has more than the bounds, as a wall has, nothing brings the plan back.

Its friends say that everything hard is done offline and that it is the one family with a proof.
So it gets stiff weights, a filter of the noise (that of `Filtered`), the exact response of the
loop with its delay, and rows for the rotors. Its estimate of the disturbance is not used: with it
the family would be offset-free control with a plan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gtmr_model import N_ZETA, Vehicle
from gtmr_model.dynamics import ROTORS, YAW, discrete_step, one_at_a_time, symbols
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.controller import fastest_iteration
from gtmr_nmpc.margins import FixedMargin
from gtmr_study.rivals.robust_mpc.ancillary import FACING_RAD, Ancillary, about_hover
from gtmr_study.rivals.robust_mpc.cost import CostParameters
from gtmr_study.rivals.robust_mpc.filtered import Filtered, near
from gtmr_study.rivals.tuning import Tuned

Array = NDArray[np.float64]

RESPONSE_STEPS = 600
"""How long responses of the error are followed, in steps: they are over long before."""
NOISE_SIGMAS = 3.0
"""Quantile of the noise, in standard deviations [-]."""
LEAST_SHARE = 0.3
"""Of a rotor's limits that the plan keeps at least [-]."""
DIGITS = 6
"""Decimals of a cross-section: the rest depends on how many threads multiply matrices."""


class TubeParameters(CostParameters):
    """What the tube is tuned by, within what its loop bears."""

    velocity_scale: float = Field(2.0, ge=0.5, le=20.0)
    """Factor of the paper's weights on velocity [-]; with less damping, flights in noise with slow
    motors turned over, one in ten, which a search of few flights does not see."""


@dataclass(frozen=True)
class CrossSection:
    """How far the vehicle may be from the plan; each is a half-width."""

    clearance_m: float
    """Across, towards the tower [m]."""
    speed_hz: float
    """Of the rotor that needs most [Hz]."""
    acceleration_hz_s: float
    """Of the rotor that needs most [Hz/s]."""


class Tube(Filtered):
    """Plan and feedback of one flight."""

    def __init__(self, config: ControllerConfig, parameters: CostParameters) -> None:
        weighed = parameters.weigh(config)
        super().__init__(weighed)
        self.cross_section = cross_section(weighed)
        tight = tightened(weighed, self.cross_section)
        # Limits are no part of what is compiled.
        iteration = fastest_iteration(weighed)
        iteration.reconfigure(tight)
        self._planner = Controller(tight, "robust", iteration)
        self._ancillary = Ancillary(weighed)
        self._nominal = _nominal_step(config.vehicle, config.sampling_time_s)
        self._now_s = math.nan
        self.z: Array | None = None
        """Nominal state, shape (12 + N_p,), at the time from which the last command acts."""

    def plan(self, now: float, x: Array) -> Array:
        """See `Filtered.plan`."""
        z = self._advanced(x, now)
        solution = self._planner.step(now, z)
        self._u_plan, self._now_s, self.z = solution.u_plan, now, z
        gain = self._ancillary.gain(z[YAW])
        return np.asarray(solution.u_plan[0] + gain @ (near(z[YAW], x) - z))

    def _advanced(self, x: Array, now: float) -> Array:
        """Move the nominal vehicle on to now; it began where the real one did."""
        if self.z is None:
            return x.copy()
        steps = round((now - self._now_s) / self.config.sampling_time_s)
        z = self.z
        for u in self._u_plan[:steps]:
            z = np.asarray(self._nominal(z, u)).ravel()
        return z


def tightened(config: ControllerConfig, section: CrossSection) -> ControllerConfig:
    """Give the problem of the plan: clearance and rotor limits less the cross-section."""
    vehicle = config.vehicle
    hover = vehicle.hover_rotor_speeds_hz
    low = min(
        vehicle.min_rotor_speed_hz + section.speed_hz,
        hover.min() - LEAST_SHARE * (hover.min() - vehicle.min_rotor_speed_hz),
    )
    high = max(
        vehicle.max_rotor_speed_hz - section.speed_hz,
        hover.max() + LEAST_SHARE * (vehicle.max_rotor_speed_hz - hover.max()),
    )
    most = vehicle.max_rotor_acceleration_hz_s
    limits = {
        "min_rotor_speed_hz": float(low),
        "max_rotor_speed_hz": float(high),
        "max_rotor_acceleration_hz_s": max(LEAST_SHARE * most, most - section.acceleration_hz_s),
    }
    return config.model_copy(
        update={
            "vehicle": vehicle.model_copy(update=limits),
            "margin": FixedMargin(margin_m=section.clearance_m),
            "tightening": "frozen",
            "delay_s": 0.0,
            "motor_lag_s": 0.0,
        }
    )


@lru_cache(maxsize=64)
def cross_section(config: ControllerConfig) -> CrossSection:
    """Bound the error's reach under constant zeta, any gusts within their bound, and noise."""
    errors, inputs = error_responses(config)
    across = _half_widths(config, errors[:, :1])
    speeds = _half_widths(config, errors[:, ROTORS])
    accelerations = _half_widths(config, inputs)
    return CrossSection(
        *(round(float(part.max()), DIGITS) for part in (across, speeds, accelerations))
    )


def error_responses(config: ControllerConfig) -> tuple[Array, Array]:
    """Follow the error x - z and the feedback K (x - z) about hover, facing the tower along -x.

    Columns are 9 for zeta, one from step 0 on, 3 for a gust of 1 N at step 0, and 12 for noise of
    one in [p, eta, v, omega] at step 0. Shapes are (K, 12 + N_p, 24) and (K, N_p, 24).
    """
    a, b, e, g = about_hover(config)
    gain = Ancillary(config).gain(FACING_RAD)
    n_x, n_u = config.vehicle.n_x, config.vehicle.n_rotors
    late = math.ceil(config.delay_s / config.sampling_time_s - 1e-9)
    columns = N_ZETA + 3 + 12
    errors = np.zeros((late + RESPONSE_STEPS + 1, n_x, columns))
    inputs = np.zeros((late + RESPONSE_STEPS, n_u, columns))
    noise = np.eye(12, columns, N_ZETA + 3)
    for k in range(late, late + RESPONSE_STEPS):
        # Measured when it was that late, and predicted with what was sent since.
        known = errors[k - late].copy()
        if k == 2 * late:
            known[:12] += noise
        for sent in inputs[k - late : k]:
            known = a @ known + b @ sent
        inputs[k] = gain @ known
        errors[k + 1] = a @ errors[k] + b @ inputs[k]
        errors[k + 1, :, :N_ZETA] += e
        if k == late:
            errors[k + 1, :, N_ZETA : N_ZETA + 3] += g
    return errors[late:], inputs[late:]


def _half_widths(config: ControllerConfig, responses: Array) -> Array:
    """Bound each row of responses, shape (K, rows, 24), for all causes; shape (rows,)."""
    box, noise = config.uncertainty, config.offset_free.noise
    constant = np.abs(responses[:, :, :N_ZETA])
    wind = constant[:, :, 6:9]
    across_n = math.hypot(*box.wind_bias_n[:2])
    by_wind = np.hypot(responses[:, :, 6], responses[:, :, 7]) * across_n
    by_wind += wind[:, :, 2] * box.wind_bias_n[2]
    by_rest = (constant[:, :, :6] * box.half_widths[:6]).sum(axis=2)
    gusts = np.linalg.norm(responses[:, :, N_ZETA : N_ZETA + 3], axis=2).sum(axis=0) * box.gust_n
    sigma = np.repeat(
        [noise.position_m, noise.attitude_rad, noise.velocity_m_s, noise.rate_rad_s], 3
    )
    random = np.sqrt(((responses[:, :, N_ZETA + 3 :] * sigma) ** 2).sum(axis=(0, 2)))
    largest = np.max(by_wind + by_rest, axis=0)
    return np.asarray(largest + gusts + NOISE_SIGMAS * random)


@lru_cache(maxsize=8)
@one_at_a_time
def _nominal_step(vehicle: Vehicle, step_s: float) -> ca.Function:
    x, u, _, _ = symbols(vehicle)
    nothing = ca.DM.zeros(N_ZETA), ca.DM.zeros(3)
    return ca.Function("nominal", [x, u], [discrete_step(x, u, *nothing, vehicle, step_s)])


TUBE = Tuned("tube", TubeParameters, Tube, constrained=True)
"""Rigid tube MPC."""
