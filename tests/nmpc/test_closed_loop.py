# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from functools import cache

import numpy as np
import pytest

from gtmr_model.dynamics import ROTORS
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.closed_loop import ClosedLoop, deviations, l1_sequence
from gtmr_nmpc.observer import motion
from gtmr_nmpc.online.sent import Sent, setpoints

STILL = {"speed_m_s": 1e-6, "climb_m_s": 0.0}
"""A reference that hovers, so that the loop is the linear one's."""
CONFIG = ControllerConfig(helix=STILL)
DELAYED = ControllerConfig(helix=STILL, delay_s=0.05)
NO_ZETA = np.zeros(9)
TS = CONFIG.sampling_time_s
STEPS = 120


@cache
def model(config):
    return motion(config.vehicle)


def fly(config, mode, force, steps=STEPS, noise=lambda _: 0.0, observe=lambda _, __: None):
    """Fly the nominal vehicle under a force per step, with a delay of whole steps."""
    controller = Controller(config, mode)
    x = config.helix.initial_state(config.tower, config.vehicle)
    late = round(config.delay_s / TS)
    states, measured = [], []
    u = np.zeros((late + 1, 6))
    for k in range(-late, steps):
        measured.append(x + noise(k))
        states.append(x)
        if k >= 0:
            solution = controller.step((k - late) * TS, measured[k], now=k * TS)
            observe(k, solution)
            u = solution.u_plan
        acting = u[0] if k >= 0 else np.zeros(6)
        pushed = force(k) if k >= 0 else np.zeros(3)
        x = np.asarray(model(config)(x, acting, pushed, np.zeros(3), TS)).ravel()
    return np.array(states[late:])


@pytest.mark.parametrize(
    ("config", "mode"),
    [(CONFIG, "nominal"), (CONFIG, "offset_free"), (DELAYED, "offset_free")],
)
def test_the_linear_loop_answers_a_gust_as_the_controller_does(config, mode):
    loop = ClosedLoop(config, mode, NO_ZETA)
    expected = loop.gusts().radial @ loop.radial
    newtons = 0.1
    pushed = fly(config, mode, lambda k: newtons * loop.radial * (k == 0))
    calm = fly(config, mode, lambda _: np.zeros(3))
    found = (pushed - calm)[:, :3] @ loop.radial / newtons
    assert np.abs(found - expected[:STEPS]).max() < 0.02 * np.abs(expected).max()


@pytest.mark.parametrize("mode", ["nominal", "offset_free"])
def test_the_worst_gusts_reach_the_l1_norm_and_no_others_tried_do(mode):
    loop = ClosedLoop(CONFIG, mode, NO_ZETA)
    radial = loop.gusts().radial[1:] @ loop.radial
    norm = np.abs(radial).sum()
    sequence = np.array(l1_sequence(CONFIG, mode))
    assert set(sequence) == {-1.0, 1.0}
    assert -(radial[::-1] @ -sequence) == pytest.approx(norm)
    rng = np.random.default_rng(0)
    for other in (*rng.choice([-1.0, 1.0], (50, len(radial))), np.ones(len(radial))):
        assert abs(radial[::-1] @ other) < norm
    # In the loop itself, by less force so that no inequality is active.
    newtons = 0.1
    tail = np.r_[sequence[-STEPS:], 0.0]
    states = fly(CONFIG, mode, lambda k: -newtons * tail[k] * loop.radial, len(tail))
    closer = 0.35 - CONFIG.tower.clearance(states)[-1]
    reach = newtons * np.abs(radial[:STEPS]).sum()
    assert closer == pytest.approx(reach, rel=0.03)


def test_noise_spreads_as_stated():
    noise = {"position_m": 2e-3, "velocity_m_s": 6e-3, "attitude_rad": 2e-3, "rate_rad_s": 2e-3}
    config = ControllerConfig(helix=STILL, offset_free={"noise": noise})
    stated = deviations(config).noise
    rng = np.random.default_rng(5)
    sigma = np.r_[np.repeat([2e-3, 2e-3, 6e-3, 2e-3], 3), np.zeros(6)]
    plans = []
    states = fly(
        config,
        "offset_free",
        lambda _: np.zeros(3),
        1500,
        lambda _: sigma * rng.normal(size=18),
        lambda _, solution: plans.append(solution.x_plan[:, 0]),
    )
    flown, plans = states[:, 0], np.array(plans)
    for stage in (0, 5, 20):
        off = flown[100 + stage :] - plans[100 : len(flown) - stage, stage]
        # The corners of mass and thrust make it a little more.
        assert 0.75 * stated[stage] < off.std() < 1.1 * stated[stage]


def test_margins_of_the_closed_loop_grow_with_bounds_and_fade_once_estimates_are_there():
    at = deviations(CONFIG)
    assert at.gust.shape == at.noise.shape == (21,)
    assert at.transient.shape[1:] == (21, 9)
    assert (np.diff(at.gust) > 0.0).all()
    assert at.transient[0, -1].sum() > 5.0 * at.transient[-1, -1].sum()
    wilder = ControllerConfig(helix=STILL, uncertainty={"gust_n": 1.2})
    np.testing.assert_allclose(deviations(wilder).gust, 2.0 * at.gust)
    controller = Controller(CONFIG, "offset_free")
    x = CONFIG.helix.initial_state(CONFIG.tower, CONFIG.vehicle)
    solutions = [controller.step(k * TS, x) for k in range(len(at.transient) + 3)]
    for k in (0, 7, len(at.transient) - 1):
        # A step is prepared before its own measurement.
        by_channel = at.transient[max(0, k - 1)]
        np.testing.assert_allclose(solutions[k].alpha_p_by_channel, by_channel)
        np.testing.assert_allclose(solutions[k].alpha_p, by_channel.sum(axis=1) + 1e-3)
        np.testing.assert_allclose(solutions[k].alpha_g, at.gust + 4.0 * at.noise)
    assert not solutions[-1].alpha_p_by_channel.any()


def test_a_state_from_before_is_useless_unless_it_is_predicted_up_to_now():
    late = 3

    def least(tell):
        config = ControllerConfig(delay_s=late * TS)
        controller = Controller(config, "offset_free")
        x = config.helix.initial_state(config.tower, config.vehicle)
        x[2] += 0.1
        past, distances = [x] * (late + 1), []
        for k in range(160):
            past = [*past[1:], x]
            told = {"now": k * TS} if tell else {}
            u = controller.step((k - late) * TS, past[0], **told).u
            x = np.asarray(model(config)(x, u, np.zeros(3), np.zeros(3), TS)).ravel()
            distances.append(
                np.linalg.norm(x[:3] - config.helix.at((k + 1) * TS, config.tower).position)
            )
        return np.max(distances[-40:])

    assert least(tell=True) < 0.01
    assert not least(tell=False) < 0.3


def test_the_rotors_are_predicted_as_a_lagging_motor_turns():
    lag_s = 0.03
    config = ControllerConfig(motor_lag_s=lag_s, delay_s=0.05)
    sent = Sent(config)
    x = config.helix.initial_state(config.tower, config.vehicle)
    speeds = x[ROTORS] + np.array([[0.0], [2.0], [1.0], [-1.0]])
    sent.add(0.0, 0.0, np.zeros((3, 6)), speeds)

    class Rotors:
        def ahead(self, x, xi, dt_s):
            return np.r_[x[:12], xi]

    turned = sent.ahead(Rotors(), x, 0.01, 0.07)[ROTORS]
    # By small steps of the motor's equation.
    xi, dt_s = x[ROTORS].copy(), 1e-6
    for t in np.arange(0.01, 0.07, dt_s):
        setpoint = x[ROTORS] + np.interp(t, 0.025 * np.arange(4), [0.0, 2.0, 1.0, -1.0])
        xi += dt_s * (setpoint - xi) / lag_s
    np.testing.assert_allclose(turned, xi, atol=1e-3)


def test_setpoints_lead_by_what_motors_lag():
    lag_s = 0.04
    config = ControllerConfig(motor_lag_s=lag_s)
    solution = Controller(config, "robust").step(
        0.0, config.helix.initial_state(config.tower, config.vehicle) + 0.05
    )
    xi, setpoint = solution.x_plan[0, ROTORS].copy(), solution.setpoints_hz
    dt_s = TS / 1000
    for k in range(1000):
        at = setpoint[0] + (k + 0.5) / 1000 * (setpoint[1] - setpoint[0])
        xi += dt_s * (at - xi) / lag_s
    np.testing.assert_allclose(xi, solution.x_plan[1, ROTORS], atol=2e-3)
    plain = Controller(ControllerConfig(), "robust").step(0.0, solution.x_plan[0])
    np.testing.assert_array_equal(plain.setpoints_hz, plain.x_plan[:, ROTORS])
    limits = setpoints(config, np.full((21, 18), 99.9), np.full((20, 6), 200.0))
    assert limits.max() == config.vehicle.max_rotor_speed_hz


def test_a_command_that_acts_before_its_state_is_refused():
    x = CONFIG.helix.initial_state(CONFIG.tower, CONFIG.vehicle)
    with pytest.raises(
        ValueError, match=r"now = 0\.9: the command cannot act before the stamp, 1"
    ):
        Controller(CONFIG).step(1.0, x, now=0.9)


@pytest.mark.parametrize("before", ["nominal", "robust", "offset_free"])
@pytest.mark.parametrize("after", ["nominal", "robust", "offset_free"])
def test_any_switch_makes_no_bump(before, after):
    config = ControllerConfig()
    controller = Controller(config, before)
    force = np.array([-0.6, 0.4, 0.3])
    x = config.helix.initial_state(config.tower, config.vehicle)
    u, jumps = None, []
    for k in range(320):
        if k == 160:
            controller.mode = after
        last, u = u, controller.step(k * TS, x).u
        jumps.append(0.0 if last is None else np.abs(u - last).max())
        x = np.asarray(model(config)(x, u, force, np.zeros(3), TS)).ravel()
    # It begins gently, and ends where the mode flies.
    assert max(jumps[158:163]) < 1.0
    assert max(jumps[158:]) < 0.1 * config.vehicle.max_rotor_acceleration_hz_s
    off_m = abs(config.tower.clearance(x) - config.helix.offset_m)
    assert (off_m < 0.01) == (after == "offset_free")
