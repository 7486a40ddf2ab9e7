# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Plans visit the points they promise, and a trial is the same flight wherever it is flown."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gtmr_model import CHANNELS, ConfigError, UncertaintySet
from gtmr_study.campaign.plans import TrialPlan
from gtmr_study.campaign.study import Study, trial_seed

BOX = UncertaintySet()


def zetas(study):
    return np.array([study.scenario(trial).zeta for trial in range(study.n_trials)])


def test_vertices_are_all_512_corners_once():
    flown = zetas(Study(plan=TrialPlan(kind="vertices")))

    assert len(flown) == len(np.unique(flown, axis=0)) == 512
    np.testing.assert_array_equal(np.abs(flown), np.tile(BOX.half_widths, (512, 1)))


def test_fewer_trials_than_vertices_are_a_fair_choice():
    flown = zetas(Study(plan=TrialPlan(kind="vertices"), trials=40))

    assert len(np.unique(flown, axis=0)) == 40
    # The first vertices in order would all have the same sign of the mass.
    assert 0.2 < (flown > 0).mean(axis=0).min() <= (flown > 0).mean(axis=0).max() < 0.8


def test_one_at_a_time_varies_one_channel_and_reaches_both_bounds():
    flown = zetas(Study(plan=TrialPlan(kind="one-at-a-time", levels=3)))

    assert len(flown) == 1 + 2 * len(CHANNELS)
    assert ((flown != 0.0).sum(axis=1) <= 1).all()
    np.testing.assert_array_equal(flown.max(axis=0), BOX.half_widths)
    np.testing.assert_array_equal(flown.min(axis=0), -BOX.half_widths)


def test_a_grid_covers_two_channels_evenly():
    flown = zetas(Study(plan=TrialPlan(kind="grid", channels=("w_bx", "w_by"), levels=4)))

    x, y = (flown[:, CHANNELS.index(name)] for name in ("w_bx", "w_by"))
    assert {(a, b) for a, b in zip(x, y, strict=True)} == {
        (a, b) for a in np.linspace(-0.8, 0.8, 4) for b in np.linspace(-0.8, 0.8, 4)
    }
    others = [j for j, name in enumerate(CHANNELS) if name not in ("w_bx", "w_by")]
    assert not flown[:, others].any()


def test_more_trials_than_points_go_round_with_other_gusts():
    study = Study(plan=TrialPlan(kind="grid", channels=("mass", "thrust"), levels=2), trials=6)

    first, again = study.scenario(1), study.scenario(5)

    assert first.zeta == again.zeta
    assert first.seed != again.seed


@pytest.mark.slow
@given(seed=st.integers(0, 2**63), trial=st.integers(0, 10**6))
def test_random_trials_lie_in_the_box_whatever_the_seed(seed, trial):
    scenario = Study(seed=seed).scenario(trial)

    assert (np.abs(scenario.zeta) <= BOX.half_widths).all()
    assert scenario == Study(seed=seed).scenario(trial)


def test_a_trial_does_not_depend_on_how_many_there_are_nor_on_the_modes():
    few, many = Study(trials=3, modes=("robust",)), Study(trials=900)

    assert few.scenario(2) == many.scenario(2)


def test_modes_are_flown_in_one_order_however_they_are_named():
    assert Study(modes=("robust", "nominal")) == Study(modes=("nominal", "robust"))


def test_seeds_of_trials_differ():
    seeds = {trial_seed(seed, trial) for seed in range(5) for trial in range(500)}

    assert len(seeds) == 2500


def test_a_box_of_the_truth_beside_that_of_the_controller():
    wide = UncertaintySet(mass=0.3)
    study = Study(uncertainty=wide, plan=TrialPlan(kind="one-at-a-time", channels=("mass",)))

    assert zetas(study)[:, 0].max() == pytest.approx(0.3)
    assert study.controller.uncertainty.mass == 0.1


BAD = {
    "unknown key": ({"trails": 3}, "trails is not a known field"),
    "unknown key below": ({"plan": {"sort": "grid"}}, "plan.sort is not a known field"),
    "unknown plan": ({"plan": {"kind": "sobol"}}, "plan.kind = 'sobol'"),
    "unknown channel": ({"plan": {"kind": "grid", "channels": ["mass", "luck"]}}, "'luck'"),
    "grid of none": ({"plan": {"kind": "grid"}}, "a grid needs 2 channels, not 0"),
    "grid of one": ({"plan": {"kind": "grid", "channels": ["mass"]}}, "a grid needs 2 channels"),
    "channels of random": ({"plan": {"channels": ["mass"]}}, "leave channels out"),
    "no trials": ({"trials": 0}, "trials = 0"),
    "mode twice": ({"modes": ["robust", "robust"]}, "a mode is named twice"),
    "unknown controller": ({"controller": "pid"}, "'pid'"),
    "vehicle in a controller": ({"controller": {"vehicle": "hexa"}}, "'hexa'"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_scenario_file_with_a_mistake_names_it(case):
    data, named = BAD[case]

    with pytest.raises(ConfigError, match=r"mine\.yaml: ") as caught:
        Study.parse(data, "mine.yaml")

    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["paper", "paper-closest", "vertices", "wind-grid", "octo"])
def test_presets_are_studies(name):
    study = Study.load("scenario", name)

    assert study.scenario(0).uncertainty == study.true_uncertainty
    assert Study.parse(study.model_dump(mode="json"), "again") == study
