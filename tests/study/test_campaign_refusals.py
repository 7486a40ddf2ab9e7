# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a campaign refuses gets one clear line and is left alone."""

import time

import pytest
from support.campaign_runs import ARGUMENTS, contents

from gtmr_study.campaign.study import Study
from gtmr_study.campaign.trials_file import open_campaign
from gtmr_study.result_files import InputError

OTHER = {
    "seed": (["--seed", 6], "seed = 5"),
    "trials": (["--trials", 7], "trials = 6"),
    "duration": (["--duration", 0.6], "duration_s = 0.5"),
    "plan": (["--plan", "vertices"], "plan.kind = 'random'"),
    "gust": (["--gust", "none"], "gust.kind = 'ou'"),
    "modes": (["--modes", "robust"], "modes = ('nominal', 'robust')"),
    "controller": (["--controller", "literal"], "controller.weights.roll_pitch = 50.0"),
}


@pytest.mark.parametrize("case", OTHER)
def test_results_of_another_campaign_are_refused_and_left_alone(case, flown, refused):
    changed, named = OTHER[case]
    before = contents(flown)

    assert named in refused("campaign", *ARGUMENTS, *changed, "--out", flown)

    assert contents(flown) == before


def test_a_folder_with_anything_else_is_refused_and_left_alone(tmp_path, refused):
    (tmp_path / "thesis.tex").write_text("keep me")

    assert "thesis.tex" in refused("campaign", *ARGUMENTS, "--out", tmp_path)

    assert contents(tmp_path) == {"thesis.tex": b"keep me"}


def test_two_processes_do_not_share_a_folder(tmp_path):
    study = Study(trials=1)
    with (
        open_campaign("--out", tmp_path / "out", study),
        pytest.raises(InputError, match="another process"),
        open_campaign("--out", tmp_path / "out", study),
    ):
        pass


BAD = {
    "scenario with an unknown key": (["--scenario", "mine.yaml"], "trails is not a known field"),
    "no such scenario": (["--scenario", "nowhere.yaml"], "nowhere.yaml"),
    "unknown plan": (["--plan", "sobol"], "plan.kind = 'sobol'"),
    "unknown mode": (["--modes", "fast"], "'fast'"),
    "unknown controller": (["--controller", "nope"], "campaign: controller = 'nope': there is "),
    "controller that is no file": (["--controller", "no.yaml"], "no.yaml"),
    "negative trials": (["--trials", "-3"], "trials = -3"),
    "trials that are no number": (["--trials", "many"], "--trials"),
    "negative seed": (["--seed", "-1"], "--seed = -1: allowed is 0 to"),
    "no workers": (["--workers", "0"], "--workers"),
    "one level": (["--plan", "one-at-a-time", "--levels", "1"], "plan.levels = 1"),
    "a grid of one channel": (["--plan", "grid", "--channels", "mass"], "a grid needs 2 channels"),
    "a grid of nothing": (["--plan", "grid"], "--plan = grid: needs --channels A,B"),
    "unknown channel": (["--plan", "grid", "--channels", "mass,foo"], "no channel 'foo'"),
    "json in no folder": (["--json", "nowhere/s.json"], "nowhere"),
    "no trials": (["--trials", "0"], "trials = 0"),
    "endless": (["--duration", "nan"], "duration_s"),
    "two places": (["--workers", "2", "--scheduler", "tcp://x:1"], "--scheduler"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_gets_one_clear_line(case, tmp_path, monkeypatch, refused):
    arguments, named = BAD[case]
    (tmp_path / "mine.yaml").write_text("trails: 3\n")
    monkeypatch.chdir(tmp_path)

    assert named in refused("campaign", *arguments, "--out", "out")

    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_said_within_ten_seconds(tmp_path, refused):
    address, start = "tcp://127.0.0.1:9", time.monotonic()

    said = refused("campaign", "--scheduler", address, "--out", tmp_path / "out")

    assert time.monotonic() - start < 10.0
    assert f"--scheduler = {address}" in said
    assert not (tmp_path / "out").exists()
