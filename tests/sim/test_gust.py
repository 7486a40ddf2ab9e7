# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Gusts: bounded, seeded, and with the statistics they claim."""

import numpy as np
import pytest

from gtmr_model import UncertaintySet
from gtmr_sim import GUST_KINDS, GustConfig, Scenario
from gtmr_sim.gust import make_gust
from gtmr_sim.noise import FOOT_M, dryden

POSITION = np.array([0.0, 1.35, 2.0])


def record(scenario, samples):
    gust = make_gust(scenario)
    return np.array([gust(0.025 * k, POSITION) for k in range(samples)])


@pytest.mark.parametrize("kind", GUST_KINDS)
@pytest.mark.parametrize("std_n", [0.25, 5.0])
def test_norm_never_exceeds_the_bound(kind, std_n):
    gust = GustConfig(kind=kind, std_n=std_n, sequence=(1.0, -0.5))
    force = record(Scenario(gust=gust), 5000)
    assert np.linalg.norm(force, axis=1).max() <= 0.6


@pytest.mark.parametrize("kind", ["ou", "dryden", "sinusoid"])
def test_seed_gives_the_same_gusts_and_another_seed_others(kind):
    first, again, other = (
        record(Scenario(seed=seed, gust=GustConfig(kind=kind)), 50) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.1


def unclipped(kind):
    return Scenario(gust=GustConfig(kind=kind), uncertainty=UncertaintySet(gust_n=1e6))


@pytest.mark.slow
def test_ornstein_uhlenbeck_has_its_variance_and_correlation_time():
    force = record(unclipped("ou"), 200_000)
    np.testing.assert_allclose(force.std(axis=0), 0.25, rtol=0.03)
    lag = round(0.5 / 0.025)
    for axis in range(3):
        correlation = np.corrcoef(force[:-lag, axis], force[lag:, axis])[0, 1]
        assert correlation == pytest.approx(np.exp(-1.0), abs=0.03)


def test_dryden_has_the_spectrum_of_mil_f_8785c():
    # Power spectral densities of the standard, in force; V and h as in the scenario's default.
    height_ft, speed = 10.0, GustConfig().airspeed_m_s
    shear = 0.177 + 0.000823 * height_ft
    length = height_ft / shear**1.2 * FOOT_M
    height = height_ft * FOOT_M
    omega = np.geomspace(1e-3, 1e3, 50)

    def transverse(std, scale):
        reduced = (scale * omega / speed) ** 2
        return std**2 * scale / speed * (1 + 3 * reduced) / (1 + reduced) ** 2

    standard = [
        2 * 0.25**2 * length / speed / (1 + (length * omega / speed) ** 2),
        transverse(0.25, length),
        transverse(0.25 * shear**0.4, height),
    ]
    for (a, b, c), density in zip(dryden(0.25, speed, 2.0), standard, strict=True):
        response = [c @ np.linalg.solve(1j * w * np.eye(len(a)) - a, b) for w in omega]
        np.testing.assert_allclose(np.abs(response) ** 2, density, rtol=1e-9)


@pytest.mark.slow
def test_dryden_is_stationary_with_its_standard_deviations():
    force = record(unclipped("dryden"), 400_000)
    shear = 0.177 + 0.000823 * 10.0
    np.testing.assert_allclose(force.std(axis=0), 0.25 * np.array([1, 1, shear**0.4]), rtol=0.05)


def test_worst_case_pushes_towards_the_tower_with_the_full_bound():
    force = record(Scenario(gust=GustConfig(kind="worst-case")), 3)
    np.testing.assert_allclose(force, [[0.0, -0.6, 0.0]] * 3, atol=1e-12)


def test_sinusoid_has_its_period_and_amplitude():
    force = record(Scenario(gust=GustConfig(kind="sinusoid", period_s=1.0)), 80)[:, 1]
    np.testing.assert_allclose(force[:40], force[40:], atol=1e-9)
    assert np.abs(force).max() == pytest.approx(0.6, rel=0.01)
