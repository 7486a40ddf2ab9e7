# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Gust forces w_g(t): bounded, seeded, one sample per hold period (Sec. III)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm, solve_continuous_lyapunov

from gtmr_sim.scenario import Scenario

Array = NDArray[np.float64]
Gust = Callable[[Array], Array]
"""Maps the vehicle's position, world frame [m], to the next gust sample, world frame [N]."""

FOOT_M = 0.3048
"""[m]"""


def make_gust(scenario: Scenario) -> Gust:
    """Start the gusts of a scenario; the same scenario gives the same gusts.

    Returns
    -------
    Gust
        To be called once every hold period.
    """
    config, bound = scenario.gust, scenario.uncertainty.gust_n
    rng = scenario.rng("gust")
    match config.kind:
        case "none":
            return lambda _: np.zeros(3)
        case "worst-case":
            return lambda position: bound * _towards_tower(position)
        case "sinusoid":
            return _sinusoid(bound, config.period_s, scenario.gust_hold_s, rng)
        case "ou":
            filters = [ornstein_uhlenbeck(config.std_n, config.correlation_time_s)] * 3
        case "dryden":
            height_m = scenario.helix.start_height_m
            filters = dryden(config.std_n, config.airspeed_m_s, height_m)
    return _clipped(_coloured_noise(filters, scenario.gust_hold_s, rng), bound)


def ornstein_uhlenbeck(std: float, correlation_time_s: float) -> tuple[Array, Array, Array]:
    """Shaping filter of an Ornstein-Uhlenbeck process.

    Returns
    -------
    tuple of NDArray
        A (1, 1), b (1,), c (1,) of ds = A s dt + b dW, output c s.
    """
    rate = 1.0 / correlation_time_s
    return np.array([[-rate]]), np.array([std * math.sqrt(2.0 * rate)]), np.array([1.0])


def dryden(std: float, airspeed_m_s: float, height_m: float) -> list[tuple[Array, Array, Array]]:
    """Shaping filters of low-altitude Dryden turbulence (MIL-F-8785C, Sec. 3.7).

    The mean wind blows along the world's x axis; force is taken as proportional to gust speed.

    Parameters
    ----------
    std : float
        Stationary standard deviation of the horizontal components.
    airspeed_m_s : float
        Speed at which the frozen turbulence passes [m/s].
    height_m : float
        Height above ground; below 10 ft the values of 10 ft hold [m].

    Returns
    -------
    list of tuple of NDArray
        A, b, c along x, y, z of ds = A s dt + b dW, output c s.
    """
    height_ft = min(max(height_m / FOOT_M, 10.0), 1000.0)
    shear = 0.177 + 0.000823 * height_ft
    horizontal_s = height_ft / shear**1.2 * FOOT_M / airspeed_m_s
    vertical_s = height_ft * FOOT_M / airspeed_m_s
    return [
        ornstein_uhlenbeck(std, horizontal_s),
        _transverse(std, horizontal_s),
        _transverse(std * shear**0.4, vertical_s),
    ]


def _transverse(std: float, time_s: float) -> tuple[Array, Array, Array]:
    """Filter std sqrt(T) (1 + sqrt(3) T s) / (1 + T s)^2 in controllable form."""
    a = np.array([[0.0, 1.0], [-1.0 / time_s**2, -2.0 / time_s]])
    b = np.array([0.0, 1.0])
    c = std * math.sqrt(time_s) * np.array([1.0 / time_s**2, math.sqrt(3.0) / time_s])
    return a, b, c


def _coloured_noise(
    filters: list[tuple[Array, Array, Array]], period_s: float, rng: np.random.Generator
) -> Gust:
    """Sample stationary filtered white noise exactly at a fixed period."""
    a = block_diag(*(f[0] for f in filters))
    b = block_diag(*(f[1][:, None] for f in filters))
    c = block_diag(*(f[2] for f in filters))
    transition = expm(a * period_s)
    stationary = solve_continuous_lyapunov(a, -b @ b.T)
    increment = np.linalg.cholesky(stationary - transition @ stationary @ transition.T)
    state = np.linalg.cholesky(stationary) @ rng.standard_normal(len(a))

    def sample(_: Array) -> Array:
        nonlocal state
        output = c @ state
        state = transition @ state + increment @ rng.standard_normal(len(a))
        return output

    return sample


def _sinusoid(bound: float, period_s: float, hold_s: float, rng: np.random.Generator) -> Gust:
    """Push to and from the tower with the full bound as amplitude and a random phase."""
    phase = rng.uniform(0.0, 2.0 * math.pi)

    def sample(position: Array) -> Array:
        nonlocal phase
        force = bound * math.sin(phase) * _towards_tower(position)
        phase += 2.0 * math.pi * hold_s / period_s
        return force

    return sample


def _clipped(gust: Gust, bound: float) -> Gust:
    def sample(position: Array) -> Array:
        force = gust(position)
        norm = float(np.linalg.norm(force))
        if norm <= bound:
            return force
        # The last factor keeps rounding from lifting the norm above the bound.
        return force * (bound / norm * (1.0 - 1e-15))

    return sample


def _towards_tower(position: Array) -> Array:
    rho = math.hypot(position[0], position[1])
    if rho == 0.0:
        return np.zeros(3)
    return np.array([-position[0] / rho, -position[1] / rho, 0.0])
