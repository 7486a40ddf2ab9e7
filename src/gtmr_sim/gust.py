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

import numpy as np
from numpy.typing import NDArray

from gtmr_sim.noise import Filter, coloured_noise, dryden, ornstein_uhlenbeck
from gtmr_sim.registry import GUSTS
from gtmr_sim.scenario import Scenario

Array = NDArray[np.float64]
Gust = Callable[[float, Array], Array]
"""Maps time since the start [s] and the vehicle's position, world frame [m], to the gust force
that is held from now on, world frame [N], shape (3,)."""


def make_gust(scenario: Scenario) -> Gust:
    """Start the gusts of a scenario, clipped to its bound; the same scenario gives the same.

    The function registered under the scenario's kind gets the scenario, from which it takes its
    random numbers (``scenario.rng("gust")``), and the kind's ``parameters`` as arguments. It
    returns a `Gust`, which is called once every hold period. Raises ValueError when a gust of
    your own gives anything but three finite numbers.
    """
    kind, bound = scenario.gust.kind, scenario.uncertainty.gust_n
    gust = GUSTS[kind](scenario, **scenario.gust.parameters)

    def sample(time_s: float, position: Array) -> Array:
        force = np.asarray(gust(time_s, position), dtype=float)
        if force.shape != (3,) or not np.isfinite(force).all():
            raise ValueError(f"gust {kind!r} gave {force} at {time_s:g} s: expected 3 forces [N]")
        norm = float(np.linalg.norm(force))
        # A force at the bound may exceed it by rounding, and stays as it is.
        if norm <= bound * (1.0 + 1e-15):
            return force
        # The last factor keeps rounding from lifting the norm above the bound.
        return force * (bound / norm * (1.0 - 1e-15))

    return sample


@GUSTS.register("ou")
def _ou(scenario: Scenario) -> Gust:
    config = scenario.gust
    axis = ornstein_uhlenbeck(config.std_n, config.correlation_time_s)
    return _coloured_noise([axis] * 3, scenario)


@GUSTS.register("dryden")
def _dryden(scenario: Scenario) -> Gust:
    config = scenario.gust
    height_m = float(scenario.helix.at(0.0, scenario.tower).position[0, 2])
    return _coloured_noise(dryden(config.std_n, config.airspeed_m_s, height_m), scenario)


@GUSTS.register("sinusoid")
def _sinusoid(scenario: Scenario) -> Gust:
    """Push to and from the tower with the full bound as amplitude and a random phase."""
    phase = scenario.rng("gust").uniform(0.0, 2.0 * math.pi)

    def sample(_: float, position: Array) -> Array:
        nonlocal phase
        force = scenario.uncertainty.gust_n * math.sin(phase) * _towards_tower(position)
        phase += 2.0 * math.pi * scenario.gust_hold_s / scenario.gust.period_s
        return force

    return sample


@GUSTS.register("worst-case")
def _worst_case(scenario: Scenario) -> Gust:
    return lambda _, position: scenario.uncertainty.gust_n * _towards_tower(position)


@GUSTS.register("l1")
def _l1(scenario: Scenario) -> Gust:
    """Push inward by shares of the bound, one a hold period, over and over."""
    scenario.gust.require_sequence()
    sequence, k = scenario.gust.sequence, -1

    def sample(_: float, position: Array) -> Array:
        nonlocal k
        k += 1
        share = sequence[k % len(sequence)]
        return share * scenario.uncertainty.gust_n * _towards_tower(position)

    return sample


@GUSTS.register("none")
def _none(_: Scenario) -> Gust:
    return lambda *_: np.zeros(3)


def _coloured_noise(filters: list[Filter], scenario: Scenario) -> Gust:
    draw = coloured_noise(filters, scenario.rng("gust"), scenario.gust_hold_s)
    return lambda *_: draw()


def _towards_tower(position: Array) -> Array:
    rho = math.hypot(position[0], position[1])
    if rho == 0.0:
        return np.zeros(3)
    return np.array([-position[0] / rho, -position[1] / rho, 0.0])
