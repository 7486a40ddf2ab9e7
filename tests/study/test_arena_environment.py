# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The arena as a Gymnasium environment: what its documentation says of it holds."""

import warnings

import numpy as np
import pytest

from gtmr_model import ConfigError
from gtmr_model.dynamics import ROTORS
from gtmr_nmpc import ControllerConfig
from gtmr_study.arena.plan import Arena, MetWorld

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from gtmr_study.arena import environment  # noqa: E402


def made(**options):
    return gymnasium.make("gtmr/Tower-v0", **options)


@pytest.mark.parametrize("world", ["paper", "field", "hard"])
def test_it_is_what_gymnasium_expects(world):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(made(world=world, d_ref_m=0.30).unwrapped)


def episode(env, actions, **reset):
    env.reset(**reset)
    return [env.step(action) for action in actions]


def test_a_seed_gives_the_same_episode_and_another_one_another():
    env = made(world="hard")
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 6)).astype(np.float32)
    first, again, other = (episode(env, actions, seed=seed) for seed in (3, 3, 4))
    assert [step[1] for step in first] == [step[1] for step in again]
    np.testing.assert_array_equal(first[-1][0], again[-1][0])
    assert not np.array_equal(first[-1][4]["zeta"], other[-1][4]["zeta"])


def test_trial_k_is_that_of_an_arena():
    worlds = (MetWorld.named("field"),)
    arena = Arena(controllers=("nominal",), worlds=worlds, d_ref_m=(0.30,))
    env = made(world="field", d_ref_m=0.30)
    _, info = env.reset(options={"trial": 7})
    np.testing.assert_array_equal(info["zeta"], arena.study("field", 0.30).scenario(7).zeta_array)
    assert env.unwrapped.config == arena.study("field", 0.30).controller


def test_on_the_reference_nothing_is_off_and_a_step_is_worth_one():
    config = ControllerConfig()
    x = config.helix.initial_state(config.tower, config.vehicle)
    seen = environment.observation(config, 0.0, x)
    np.testing.assert_allclose(seen[:12], 0.0, atol=1e-6)
    np.testing.assert_allclose(seen[12:18], x[ROTORS], rtol=1e-6)
    assert seen[18] == pytest.approx(config.helix.offset_m - config.tower.min_clearance_m)
    (step,) = episode(made(), [np.zeros(6, np.float32)], seed=0)
    assert step[1] == pytest.approx(1.0, abs=1e-3)
    assert made().observation_space.contains(seen)


def test_a_step_towards_the_tower_is_ahead():
    config = ControllerConfig()
    x = config.helix.initial_state(config.tower, config.vehicle)
    towards = -x[:2] / np.hypot(*x[:2])
    x[:2] += 0.1 * towards
    seen = environment.observation(config, 0.0, x)
    np.testing.assert_allclose(seen[:3], [0.1, 0.0, 0.0], atol=1e-6)
    assert seen[18] == pytest.approx(config.helix.offset_m - config.tower.min_clearance_m - 0.1)


@pytest.mark.parametrize("share", [1.0, -1.0])
def test_who_falls_or_climbs_away_is_lost_and_pays_for_it(share):
    steps = episode(made(), [np.full(6, share, np.float32)] * 80, seed=0)
    ended = next(k for k, step in enumerate(steps) if step[2])
    assert not any(step[3] for step in steps[: ended + 1])
    assert steps[ended][1] == pytest.approx(-environment.END - environment.EFFORT, abs=1e-6)


def test_too_close_costs_one_a_step():
    env = made(d_ref_m=0.15)
    (step,) = episode(env, [np.zeros(6, np.float32)], seed=0)
    assert step[1] == pytest.approx(1.0 - environment.VIOLATION, abs=1e-3)


def test_it_is_truncated_at_the_duration():
    steps = episode(made(duration_s=0.1), [np.zeros(6, np.float32)] * 4, seed=0)
    assert [(step[2], step[3]) for step in steps] == [(False, False)] * 3 + [(False, True)]


def test_a_world_that_there_is_not_is_refused():
    with pytest.raises(ConfigError, match="'calm'"):
        made(world="calm")
