# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import numpy as np
import pytest

from gtmr_model.dynamics import ATTITUDE, ROTORS, YAW
from gtmr_model.vehicle import GRAVITY_M_S2
from gtmr_nmpc import ControllerConfig
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.observer import (
    BIAS,
    GUST,
    TORQUE,
    InterpretedObserver,
    bounds,
    gains,
    motion,
)

CONFIG = ControllerConfig()
TS = CONFIG.sampling_time_s
NOISY = ControllerConfig.model_validate(
    {
        "offset_free": {
            "noise": {
                "position_m": 0.01,
                "velocity_m_s": 0.03,
                "attitude_rad": 0.01,
                "rate_rad_s": 0.01,
            }
        }
    }
)


def hover(config=CONFIG):
    return config.helix.initial_state(config.tower, config.vehicle)


def observers(config=CONFIG):
    iteration = CompiledIteration(config)
    return {
        "compiled": (iteration.observer(), iteration),
        "numpy": (InterpretedObserver(config), 0),
    }


def fly(observer, config, seconds, force=(0, 0, 0), torque=(0, 0, 0), u=None, x=None, noise=None):
    """Fly the model with a force and a torque that the observer does not know of."""
    step = motion(config.vehicle)
    x = hover(config) if x is None else x
    u = np.zeros(config.vehicle.n_rotors) if u is None else u
    for _ in range(round(seconds / TS)):
        x = np.asarray(step(x, u, force, torque, TS)).ravel()
        measured = x if noise is None else x + noise()
        estimate = observer.update(measured, TS)
    return x, estimate


@pytest.mark.parametrize("which", ["compiled", "numpy"])
def test_a_constant_force_and_torque_are_found(which):
    observer, _ = observers()[which]
    observer.update(hover(), 0.0)
    force, torque = np.array([0.5, -0.4, 0.8]), np.array([0.002, -0.003, 0.001])
    x, (estimated, theta) = fly(observer, CONFIG, 3.0, force, torque)
    np.testing.assert_allclose(theta[BIAS] + theta[GUST], force, atol=1e-3)
    np.testing.assert_allclose(theta[TORQUE], torque, atol=1e-6)
    np.testing.assert_allclose(estimated, x, atol=1e-5)
    # What lasts is put down to what lasts.
    assert np.abs(theta[GUST]).max() < 0.1 * np.abs(theta[BIAS]).max()


def test_a_mass_that_changes_in_flight_becomes_a_force_within_bounds():
    observer, _ = observers()["compiled"]
    observer.update(hover(), 0.0)
    fly(observer, CONFIG, 1.0)
    _, (_, theta) = fly(observer, CONFIG, 1.0, force=(0.0, 0.0, -0.2 * GRAVITY_M_S2))
    np.testing.assert_allclose((theta[BIAS] + theta[GUST])[2], -0.2 * GRAVITY_M_S2, rtol=5e-3)


@pytest.mark.parametrize("which", ["compiled", "numpy"])
def test_a_measurement_out_of_this_world_is_forgotten_with_the_next_one(which):
    observer, _ = observers()[which]
    observer.update(hover(), 0.0)
    far = hover()
    far[ROTORS] = 1e200
    observer.update(far, TS)
    estimate = observer.update(hover(), TS)
    np.testing.assert_array_equal(estimate.x, hover())
    np.testing.assert_array_equal(estimate.theta, np.zeros(9))


@pytest.mark.parametrize("which", ["compiled", "numpy"])
def test_a_vehicle_held_by_the_ground_winds_up_no_further_than_the_bounds(which):
    observer, _ = observers()[which]
    x = hover()
    x[ROTORS] = CONFIG.vehicle.min_rotor_speed_hz
    for _ in range(400):
        estimate = observer.update(x, TS)
    most = bounds(CONFIG)
    assert (np.abs(estimate.theta) <= most).all()
    assert estimate.theta[2] == most[2]
    # Once it flies, the truth is found again within half a second.
    _, (_, theta) = fly(observer, CONFIG, 0.5)
    assert np.abs(theta[BIAS] + theta[GUST]).max() < 0.1


def test_rotors_that_do_other_than_they_are_told_are_no_disturbance():
    observer, _ = observers()["compiled"]
    observer.update(hover(), 0.0)
    _, (_, theta) = fly(observer, CONFIG, 0.3, u=np.full(6, 30.0))
    assert np.abs(theta).max() < 1e-9


def test_compiled_and_numpy_are_the_same():
    rng = np.random.default_rng(3)
    both = observers(NOISY)
    x = hover(NOISY)
    for k in range(60):
        x = x + rng.normal(size=18) * np.repeat([0.01, 0.02, 0.03, 0.05, 0.5], [3, 3, 3, 3, 6])
        dt_s = (0.0, TS, TS, 0.6 * TS, 3.0 * TS, 2.4 * TS, 30.0 * TS)[k % 7]
        turned = x.copy()
        turned[YAW] += 2.0 * np.pi * (k % 3 - 1)
        first, second = (observer.update(turned, dt_s) for observer, _ in both.values())
        np.testing.assert_allclose(first.x, second.x, atol=1e-11)
        np.testing.assert_allclose(first.theta, second.theta, atol=1e-10)
        ahead = [o.ahead(x, x[ROTORS] + 1.0, 0.013) for o, _ in both.values()]
        np.testing.assert_allclose(*ahead, atol=1e-11)


def test_the_gain_is_the_best_for_the_stated_noise():
    # Of the position of a filter whose gain is scaled, the error is larger either way.
    rng = np.random.default_rng(1)
    noise = NOISY.offset_free.noise
    sigma = np.repeat(
        [noise.position_m, noise.attitude_rad, noise.velocity_m_s, noise.rate_rad_s, 0.0],
        [3, 3, 3, 3, 6],
    )

    def error(scale):
        by = gains(NOISY).translation * scale
        a = np.array([[1.0, TS, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0.951]])
        a[:2, 2:] = np.array([[0.5 * TS**2], [TS]]) / NOISY.vehicle.mass_kg
        truth, estimate, errors = np.zeros(4), np.zeros(4), []
        model, draws = NOISY.offset_free.disturbance, np.random.default_rng(2)
        for _ in range(20000):
            truth = a @ truth
            truth[2] += model.bias_n_per_sqrt_s * TS**0.5 * draws.normal()
            truth[3] += model.gust_n * (1.0 - 0.951**2) ** 0.5 * draws.normal()
            measured = truth[:2] + draws.normal(size=2) * (noise.position_m, noise.velocity_m_s)
            estimate = a @ estimate
            estimate = estimate + by @ (measured - estimate[:2])
            errors.append(estimate[0] - truth[0])
        return np.std(errors)

    best = error(1.0)
    assert best < error(0.6)
    assert best < error(1.5)
    observer, _ = observers(NOISY)["compiled"]
    observer.update(hover(NOISY), 0.0)
    x, (estimated, _) = fly(observer, NOISY, 3.0, noise=lambda: rng.normal(size=18) * sigma)
    assert np.abs((estimated - x)[ATTITUDE]).max() < noise.attitude_rad
