# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Gust forces w_g(t): bounded, seeded, one sample per hold period (Sec. III)."""

import math
from collections.abc import Callable
from itertools import cycle, islice

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_sim.noise import ColouredNoise, Filter, dryden, ornstein_uhlenbeck
from gtmr_sim.registry import GUSTS
from gtmr_sim.scenario import Scenario

Array = NDArray[np.float64]
Sample = Callable[[float, Array], ArrayLike]
"""Maps time since the start [s] and the vehicle's position, world frame [m], to the gust force
that is held from now on, world frame [N], shape (3,)."""


class Ahead:
    """Gusts that are known ahead; those towards the tower but for where that will be.

    Parameters
    ----------
    draw : callable
        Gives the next n of them: forces, world frame, of shape (n, 3), or amounts towards the
        tower, of shape (n,) [N]; the same in pieces or at once.
    inward : bool
        Whether it gives amounts.
    """

    def __init__(self, draw: Callable[[int], ArrayLike], inward: bool) -> None:
        self.draw, self.inward = draw, inward

    def __call__(self, _: float, position: Array) -> Array:
        """Draw the next one alone, as a `Sample` does."""
        (first,) = np.asarray(self.draw(1), dtype=float)
        return np.asarray(first * _towards_tower(position) if self.inward else first)


class Gust:
    """Gusts of a flight, clipped to their bound, one a hold period."""

    def __init__(self, kind: str, bound_n: float, sample: Sample) -> None:
        self._kind, self._bound_n, self._sample = kind, bound_n, sample
        self.inward = isinstance(sample, Ahead) and sample.inward
        """Whether `rows` gives amounts towards the tower, not forces."""

    def __call__(self, time_s: float, position: Array) -> Array:
        """Draw the next one as a `Sample` does; ValueError if it is not three finite numbers."""
        force = np.asarray(self._sample(time_s, position), dtype=float)
        if force.shape != (3,) or not np.isfinite(force).all():
            raise ValueError(
                f"gust {self._kind!r} gave {force} at {time_s:g} s: expected 3 forces [N]"
            )
        return self._clipped(force)

    def rows(self, n: int, time_s: float, position: Array) -> Array:
        """Draw the next ones ahead, shape (n, 3), or (n, 1) where they are amounts inward.

        Of gusts that are not known ahead it is one row, the force from now on.
        """
        if not isinstance(self._sample, Ahead):
            return self(time_s, position)[None]
        drawn = np.array(self._sample.draw(n), dtype=float).reshape(n, -1)
        if not self.inward:
            near = np.sqrt((drawn * drawn).sum(axis=1)) > self._bound_n * (1.0 - 1e-9)
            for i in np.flatnonzero(near):
                drawn[i] = self._clipped(drawn[i])
        return drawn

    def _clipped(self, force: Array) -> Array:
        norm = float(np.linalg.norm(force))
        # A force at the bound may exceed it by rounding, and stays as it is.
        if norm <= self._bound_n * (1.0 + 1e-15):
            return force
        # The last factor keeps rounding from lifting the norm above the bound.
        return force * (self._bound_n / norm * (1.0 - 1e-15))


def make_gust(scenario: Scenario) -> Gust:
    """Start the gusts of a scenario, clipped to its bound; the same scenario gives the same.

    The function registered under the scenario's kind gets the scenario, from which it takes its
    random numbers (``scenario.rng("gust")``), and the kind's ``parameters`` as arguments. It
    returns a `Sample`, which is called once every hold period, or an `Ahead`, which is faster.
    Raises ValueError when a gust of your own gives anything but three finite numbers.
    """
    kind = scenario.gust.kind
    sample = GUSTS[kind](scenario, **scenario.gust.parameters)
    return Gust(kind, scenario.uncertainty.gust_n, sample)


@GUSTS.register("ou")
def _ou(scenario: Scenario) -> Ahead:
    config = scenario.gust
    axis = ornstein_uhlenbeck(config.std_n, config.correlation_time_s)
    return _coloured_noise([axis] * 3, scenario)


@GUSTS.register("dryden")
def _dryden(scenario: Scenario) -> Ahead:
    config = scenario.gust
    height_m = float(scenario.helix.at(0.0, scenario.tower).position[0, 2])
    return _coloured_noise(dryden(config.std_n, config.airspeed_m_s, height_m), scenario)


@GUSTS.register("sinusoid")
def _sinusoid(scenario: Scenario) -> Ahead:
    """Push to and from the tower with the full bound as amplitude and a random phase."""
    bound_n = scenario.uncertainty.gust_n
    turn = 2.0 * math.pi * scenario.gust_hold_s / scenario.gust.period_s
    phase = scenario.rng("gust").uniform(0.0, 2.0 * math.pi)

    def draw(n: int) -> list[float]:
        nonlocal phase
        amounts = []
        for _ in range(n):
            amounts.append(bound_n * math.sin(phase))
            phase += turn
        return amounts

    return Ahead(draw, inward=True)


@GUSTS.register("worst-case")
def _worst_case(scenario: Scenario) -> Ahead:
    return Ahead(lambda n: np.full(n, scenario.uncertainty.gust_n), inward=True)


@GUSTS.register("l1")
def _l1(scenario: Scenario) -> Ahead:
    """Push inward by shares of the bound, one a hold period, over and over."""
    scenario.gust.require_sequence()
    over_and_over = cycle(np.array(scenario.gust.sequence) * scenario.uncertainty.gust_n)
    return Ahead(lambda n: list(islice(over_and_over, n)), inward=True)


@GUSTS.register("none")
def _none(_: Scenario) -> Ahead:
    return Ahead(lambda n: np.zeros((n, 3)), inward=False)


def _coloured_noise(filters: list[Filter], scenario: Scenario) -> Ahead:
    noise = ColouredNoise(filters, scenario.rng("gust"), scenario.gust_hold_s)
    return Ahead(noise.draw, inward=False)


def _towards_tower(position: Array) -> Array:
    rho = math.hypot(position[0], position[1])
    if rho == 0.0:
        return np.zeros(3)
    return np.array([-position[0] / rho, -position[1] / rho, 0.0])
