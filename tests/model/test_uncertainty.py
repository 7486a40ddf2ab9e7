# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The box of zeta."""

import numpy as np
import pytest

from gtmr_model import CHANNELS, UncertaintySet


def test_half_widths_are_table_1():
    table = [0.10, 0.15, 0.15, 0.20, 0.10, 0.20, 0.8, 0.8, 0.3]
    np.testing.assert_array_equal(UncertaintySet().half_widths, table)
    assert UncertaintySet().gust_n == 0.6


def test_vertices_are_all_512_sign_patterns():
    vertices = UncertaintySet().vertices()
    assert len(np.unique(vertices, axis=0)) == 512
    np.testing.assert_array_equal(
        np.abs(vertices), np.tile(UncertaintySet().half_widths, (512, 1))
    )


def test_samples_fill_the_box_uniformly():
    box = UncertaintySet()
    samples = np.array([box.sample(np.random.default_rng(k)) for k in range(4000)])
    assert (np.abs(samples) <= box.half_widths).all()
    relative = samples / box.half_widths
    np.testing.assert_allclose(relative.mean(axis=0), 0.0, atol=0.05)
    np.testing.assert_allclose(relative.var(axis=0), 1 / 3, atol=0.02)


@pytest.mark.parametrize("channel", range(9))
def test_zeta_outside_names_channel_value_and_range(channel):
    zeta = np.zeros(9)
    zeta[channel] = -2.0
    with pytest.raises(ValueError, match=rf"zeta\[{CHANNELS[channel]}\] = -2: allowed is"):
        UncertaintySet().require_inside(zeta)


@pytest.mark.parametrize("zeta", [np.zeros(8), np.full(9, np.nan)])
def test_zeta_of_wrong_length_or_nan_is_refused(zeta):
    with pytest.raises(ValueError, match="zeta"):
        UncertaintySet().require_inside(zeta)
