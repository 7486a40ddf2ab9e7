# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Coloured noise: shaping filters of white noise, sampled exactly."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Filter = tuple[Array, Array, Array]
"""A, b, c of ds = A s dt + b dW, output c s."""

FOOT_M = 0.3048
"""[m]"""


def ornstein_uhlenbeck(std: float, correlation_time_s: float) -> Filter:
    """Shaping filter of an Ornstein-Uhlenbeck process with its stationary standard deviation."""
    rate = 1.0 / correlation_time_s
    return np.array([[-rate]]), np.array([std * math.sqrt(2.0 * rate)]), np.array([1.0])


def dryden(std: float, airspeed_m_s: float, height_m: float) -> list[Filter]:
    """Shaping filters of low-altitude Dryden turbulence (MIL-F-8785C, Sec. 3.7).

    Along the mean wind, across it and up; std is the stationary standard deviation of the
    horizontal components, of speed, or of a force that is taken as proportional to it. The frozen
    turbulence passes at the airspeed [m/s]; below 10 ft above ground the values of 10 ft hold.
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


def _transverse(std: float, time_s: float) -> Filter:
    """Filter std sqrt(T) (1 + sqrt(3) T s) / (1 + T s)^2 in controllable form."""
    a = np.array([[0.0, 1.0], [-1.0 / time_s**2, -2.0 / time_s]])
    b = np.array([0.0, 1.0])
    c = std * math.sqrt(time_s) * np.array([1.0 / time_s**2, math.sqrt(3.0) / time_s])
    return a, b, c


def _block_diagonal(blocks: list[Array]) -> Array:
    """Lay matrices along the diagonal of one."""
    shapes = np.array([block.shape for block in blocks])
    whole, at = np.zeros(shapes.sum(axis=0)), np.zeros(2, dtype=int)
    for block, shape in zip(blocks, shapes, strict=True):
        (row, column), (end_row, end_column) = at, at + shape
        whole[row:end_row, column:end_column] = block
        at = at + shape
    return whole


def coloured_noise(
    filters: list[Filter], rng: np.random.Generator, period_s: float
) -> Callable[[], Array]:
    """Sample stationary filtered white noise exactly, once every period [s].

    What it gives is called for the next sample, one number a filter.
    """
    a = _block_diagonal([a for a, _, _ in filters])
    b = _block_diagonal([b[:, None] for _, b, _ in filters])
    c = _block_diagonal([c[None, :] for _, _, c in filters])
    if all(len(f[0]) == 1 for f in filters):
        # Filters of one state each do not mix, and have closed forms.
        rates = np.diag(a)
        transition = np.diag(np.exp(rates * period_s))
        stationary = np.diag(np.diag(b) ** 2 / (-2.0 * rates))
    else:
        # Here, as it takes longer to import than all else of a flight's start.
        from scipy.linalg import expm, solve_continuous_lyapunov

        transition = expm(a * period_s)
        stationary = solve_continuous_lyapunov(a, -b @ b.T)
    increment = np.linalg.cholesky(stationary - transition @ stationary @ transition.T)
    state = np.linalg.cholesky(stationary) @ rng.standard_normal(len(a))

    def sample() -> Array:
        nonlocal state
        output = c @ state
        state = transition @ state + increment @ rng.standard_normal(len(a))
        return output

    return sample
