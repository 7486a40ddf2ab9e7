# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Coloured noise: shaping filters of white noise, sampled exactly."""

import math

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


class ColouredNoise:
    """Stationary filtered white noise, sampled exactly once every period [s]."""

    def __init__(self, filters: list[Filter], rng: np.random.Generator, period_s: float) -> None:
        a = _block_diagonal([a for a, _, _ in filters])
        b = _block_diagonal([b[:, None] for _, b, _ in filters])
        self._c = _block_diagonal([c[None, :] for _, _, c in filters])
        self._rng = rng
        self._of_one_state = all(len(f[0]) == 1 for f in filters)
        if self._of_one_state:
            # Filters of one state each do not mix, and have closed forms.
            rates = np.diag(a)
            self._transition = np.diag(np.exp(rates * period_s))
            stationary = np.diag(np.diag(b) ** 2 / (-2.0 * rates))
        else:
            # Here, as it takes longer to import than all else of a flight's start.
            from scipy.linalg import expm, solve_continuous_lyapunov

            self._transition = expm(a * period_s)
            stationary = solve_continuous_lyapunov(a, -b @ b.T)
        left = stationary - self._transition @ stationary @ self._transition.T
        self._increment = np.linalg.cholesky(left)
        self._state: Array = np.linalg.cholesky(stationary) @ rng.standard_normal(len(a))

    def draw(self, n: int) -> Array:
        """Sample the next n, shape (n, number of filters); the same in pieces or at once."""
        noise = self._rng.standard_normal((n, len(self._state)))
        if self._of_one_state:
            return self._draw_apart(noise)
        rows = np.empty((n, len(self._c)))
        for row, white in zip(rows, noise, strict=True):
            row[:] = self._c @ self._state
            self._state = self._transition @ self._state + self._increment @ white
        return rows

    def _draw_apart(self, noise: Array) -> Array:
        """Draw from filters of one state each, one after the other."""
        noise *= np.diag(self._increment)
        states = np.empty_like(noise)
        for i, kept in enumerate(np.diag(self._transition).tolist()):
            state, column = float(self._state[i]), []
            for white in noise[:, i].tolist():
                column.append(state)
                state = kept * state + white
            states[:, i], self._state[i] = column, state
        return np.asarray(states * np.diag(self._c))
