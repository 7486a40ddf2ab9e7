# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Measured odometry: noise, drift, age and losses are what is asked for, and nothing else is."""

import math

import numpy as np
import pytest

from gtmr_model import ConfigError
from gtmr_sim import Scenario, Simulation, World
from gtmr_sim.worlds.sensor import Odometry, Sensor

X = np.r_[1.35, 0.0, 2.0, 0.1, -0.2, 3.1, 0.0, 0.5, 0.05, 0.3, 0.2, 0.1, np.full(6, 61.5)]


def sensor(seed=0, **odometry):
    return Sensor(Odometry(**odometry), np.random.default_rng(seed), 1e-3, 25)


def readings(n, **odometry):
    measure = sensor(**odometry)
    return np.array([measure.reading(X) for _ in range(n)])


def test_noise_has_the_deviations_asked_for():
    stds = {"position_std_m": 0.01, "velocity_std_m_s": 0.03, "rate_std_rad_s": 0.02}
    off = (readings(20_000, **stds, attitude_std_deg=0.6) - X)[:, :12]
    # Yaw is near pi, and wraps.
    off[:, 3:6] = (off[:, 3:6] + np.pi) % (2.0 * np.pi) - np.pi
    expected = np.repeat([0.01, math.radians(0.6), 0.03, 0.02], 3)
    np.testing.assert_allclose(off.std(axis=0), expected, rtol=0.03)
    assert (np.abs(off.mean(axis=0)) < 4.0 * expected / math.sqrt(20_000)).all()


def test_bias_is_a_gauss_markov_process_of_its_deviation_and_time():
    bias = readings(200_000, bias_std_m=0.02, bias_time_s=0.25)[:, :3] - X[:3]
    np.testing.assert_allclose(bias.std(axis=0), 0.02, rtol=0.03)
    after = (bias[10:] * bias[:-10]).mean(axis=0) / bias.var(axis=0)
    np.testing.assert_allclose(after, math.exp(-1.0), atol=0.03)


def test_angles_are_told_between_minus_pi_and_pi():
    x = X.copy()
    x[5] = 7.0
    assert sensor(rotor_quantum_hz=0.1).reading(x)[5] == pytest.approx(7.0 - 2.0 * math.pi)


def test_rotor_speeds_are_told_in_steps():
    told = sensor(rotor_quantum_hz=0.24).reading(X)[12:]
    np.testing.assert_allclose(told / 0.24, np.round(61.5 / 0.24))
    assert np.abs(told - 61.5).max() <= 0.12


def arrivals(n=4000, **odometry):
    """Ages of all measurements when they arrive, and their stamps, in plant steps."""
    measure, found, last = sensor(**odometry), [], -1
    for step in range(25 * n):
        if step % 25 == 0:
            measure.measure(step, X)
        newest = measure.newest(step)
        if newest is not None and newest[0] != last:
            last = newest[0]
            found.append((step - last, last))
    return np.array(found).T


def test_age_is_the_delay_less_an_even_jitter_and_the_first_is_there_at_once():
    age, stamp = arrivals(delay_s=0.05, jitter_s=0.01)
    assert (stamp[0], age[0]) == (0, 0)
    # Rounded up to the next plant step.
    assert set(age[1:]) == set(range(41, 51))
    assert age[1:].mean() == pytest.approx(45.5, abs=0.2)
    assert (np.diff(stamp) == 25).all()


def test_share_of_losses_is_that_asked_for():
    _, stamp = arrivals(delay_s=0.005, dropout=0.3)
    assert len(stamp) / 4000 == pytest.approx(0.7, abs=0.03)


def test_a_jitter_that_would_measure_the_future_is_refused():
    with pytest.raises(ConfigError, match=r"jitter_s = 0.02: allowed is at most delay_s"):
        World.parse({"odometry": {"delay_s": 0.01, "jitter_s": 0.02}}, "world")


def late(**odometry):
    return Simulation(Scenario(world=World(odometry=Odometry(**odometry))), 0.025)


def test_a_simulation_hands_out_each_measurement_once_with_the_state_of_its_stamp():
    simulation, truth, handed = late(delay_s=0.05), {}, []
    simulation.command(0.0, np.full((40, 6), 5.0))
    for k in range(20):
        truth[k] = simulation.x
        newest = simulation.measured()
        assert simulation.measured() is None
        if newest is not None:
            stamp_s, x = newest
            handed.append((k, round(stamp_s / 0.025)))
            np.testing.assert_allclose(np.sin(x), np.sin(truth[handed[-1][1]]), atol=1e-12)
        simulation.advance(0.025)
    assert handed == [(0, 0)] + [(k, k - 2) for k in range(3, 20)]


def test_without_a_sensor_the_truth_is_handed_out_at_once():
    simulation = Simulation(Scenario(), 0.025)
    simulation.advance(0.025)
    stamp_s, x = simulation.measured()
    assert stamp_s == simulation.time_s
    np.testing.assert_array_equal(x, simulation.x)
    assert simulation.measured() is None


def test_a_rate_of_no_whole_number_of_plant_steps_is_refused():
    with pytest.raises(ConfigError, match=r"the period of rate_hz = 0.00333"):
        late(delay_s=0.01, rate_hz=300.0)


def test_what_is_measured_changes_no_gust_and_not_the_flight():
    noisy, plain = late(position_std_m=0.01, delay_s=0.02), Simulation(Scenario(), 0.025)
    for simulation in (noisy, plain):
        simulation.command(0.0, np.zeros((20, 6)))
        simulation.advance(0.2)
    np.testing.assert_allclose(noisy.x, plain.x, atol=1e-12)
    np.testing.assert_array_equal(noisy.gust_n, plain.gust_n)
