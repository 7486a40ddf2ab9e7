# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The statistics that reports and the JSON output are made of."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gtmr_model import Tower
from gtmr_monitor.residual import ResidualWatch, residual_statistics, solve_statistics

METRES = st.floats(-1.0, 1.0)
SAMPLES = arrays(float, st.integers(1, 60), elements=METRES)


def test_of_an_even_spread_is_the_closed_form():
    statistics = residual_statistics(np.linspace(-0.4, 0.0, 401), min_clearance_m=0.2)

    assert statistics["samples"] == 401
    assert statistics["residual_m"] == pytest.approx(
        {"min": -0.4, "q1": -0.3, "median": -0.2, "q3": -0.1, "max": 0.0}
    )


def test_keys_are_those_of_the_json_output():
    statistics = residual_statistics([-0.1], 0.2)

    assert list(statistics) == ["min_clearance_m", "violated", "samples", "residual_m"]
    assert list(statistics["residual_m"]) == ["min", "q1", "median", "q3", "max"]
    assert list(solve_statistics([1.0])) == ["median", "p99", "max"]


@given(SAMPLES)
def test_quartiles_split_the_sorted_samples(samples):
    quartiles = residual_statistics(samples, 0.2)["residual_m"]

    for share, key in [(0.25, "q1"), (0.5, "median"), (0.75, "q3")]:
        rank = share * (len(samples) - 1)
        below, above = np.sort(samples)[[math.floor(rank), math.ceil(rank)]]
        expected = below + (rank - math.floor(rank)) * (above - below)
        assert quartiles[key] == pytest.approx(expected, abs=1e-12)
    assert quartiles["min"] == samples.min()
    assert quartiles["max"] == samples.max()


@given(SAMPLES)
def test_violated_says_that_a_clearance_was_below_the_minimum(samples):
    statistics = residual_statistics(samples, 0.2)

    assert statistics["violated"] is bool((samples > 0.0).any())
    assert statistics["min_clearance_m"] == pytest.approx((0.2 - samples).min())


def test_at_exactly_the_minimum_clearance_nothing_is_violated():
    assert residual_statistics([-0.1, 0.0], 0.2)["violated"] is False


def test_of_positions_around_the_tower_agrees_with_the_distance_to_its_axis():
    tower = Tower()
    angle = np.linspace(0.0, 6.0, 50)
    radius = np.linspace(1.15, 1.5, 50)
    p = np.stack([radius * np.cos(angle), radius * np.sin(angle), angle], axis=1)

    statistics = residual_statistics(tower.residual(p), tower.min_clearance_m)

    assert statistics["min_clearance_m"] == pytest.approx(0.15)
    assert statistics["violated"] is True


def test_solve_times_agree_with_their_ranks():
    statistics = solve_statistics(np.arange(101.0))

    assert statistics == {"median": 50.0, "p99": 99.0, "max": 100.0}


@pytest.mark.parametrize("bad", [[], [0.1, math.nan], [math.inf]])
def test_samples_that_say_nothing_are_refused(bad):
    with pytest.raises(ValueError, match="residual_m"):
        residual_statistics(bad, 0.2)
    with pytest.raises(ValueError, match="solve_ms"):
        solve_statistics(bad)


@given(st.lists(METRES, min_size=1, max_size=40))
def test_watching_sample_by_sample_sees_what_the_whole_flight_shows(samples):
    watch = ResidualWatch()
    for s in samples:
        watch.update(s)

    assert watch.samples == len(samples)
    assert watch.current_m == samples[-1]
    assert watch.worst_m == max(samples)
    assert watch.violations == sum(s > 0.0 for s in samples)
