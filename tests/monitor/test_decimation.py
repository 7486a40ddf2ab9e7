# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gtmr_monitor.report.decimation import kept

LENGTHS, POINTS = st.integers(1, 5000), st.integers(4, 200)


@given(st.integers(0, 2**32 - 1), LENGTHS, POINTS)
def test_the_least_the_largest_and_both_ends_are_kept_of_every_curve(seed, n, most):
    values = np.random.default_rng(seed).normal(size=n)

    shown = kept(values, most)

    assert len(shown) <= max(most, 4)
    assert {0, n - 1, values.argmin(), values.argmax()} <= set(shown)
    assert (np.diff(shown) > 0).all()


def test_every_dip_of_a_single_sample_survives():
    clearance = np.full(144_000, 0.35)
    dips = np.arange(1000, 144_000, 12_345)
    clearance[dips] = 0.19

    shown = kept(clearance)

    assert len(shown) <= 4000
    assert set(dips) <= set(shown)


def test_what_is_no_number_hides_no_extreme():
    values = np.sin(np.linspace(0.0, 60.0, 10_000))
    values[::7] = np.nan

    shown = values[kept(values, 500)]

    assert np.nanmin(shown) == pytest.approx(np.nanmin(values))
    assert np.nanmax(shown) == pytest.approx(np.nanmax(values))
