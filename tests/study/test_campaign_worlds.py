# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Worlds, distances and worst gusts on the command line, for one flight and for many."""

import json

import numpy as np
import pandas as pd
import pytest
from support.campaign_runs import rows_of, without_times

from gtmr_model import ConfigError
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.closed_loop import l1_sequence
from gtmr_sim import World, fly
from gtmr_study.campaign.run import fly_campaign
from gtmr_study.campaign.study import Study, controller_for, worst_gusts
from gtmr_study.campaign.summary import summarise
from gtmr_study.campaign.trial import ADDED_COLUMNS, fly_trial
from gtmr_study.campaign.trials_file import read_trials
from gtmr_study.cli.campaigns.campaign import with_options

HOLDS = """
import numpy as np
class Holds:
    def __init__(self, config): pass
    def step(self, t, x): return np.zeros(6)
"""


def test_a_world_brings_the_controller_that_is_told_of_it():
    assert [controller_for(World.load("world", name)) for name in ("paper", "field", "hard")] == [
        "default",
        "field",
        "hard",
    ]
    assert controller_for(World.parse({"motors": {"lag_s": 0.03}}, "world")) == "default"
    field = ControllerConfig.load("controller", "field")
    assert Study.parse({"world": "field"}, "study").controller == field
    assert with_options(Study(), world="field").controller == field
    named = with_options(Study(), world="field", controller="literal")
    assert named.controller == ControllerConfig.load("controller", "literal")


def test_fly_in_a_world_at_a_distance_tells_what_it_met(tmp_path, gtmr):
    npz, out = tmp_path / "flight.npz", tmp_path / "flight.json"
    run = gtmr(
        *("fly", "--world", "field", "--d-ref", 0.3, "--mode", "offset_free", "--sample"),
        *("--duration", 1, "--out", npz, "--json", out),
    )
    assert run.returncode == 0, run.stderr
    result, log = json.loads(out.read_text()), np.load(npz)
    assert result["world"] == "field"
    assert log["d_T"][0] == pytest.approx(0.3)
    assert np.abs(log["x_measured"] - log["x"])[:, :3].max() > 1e-3
    assert result["min_clearance_any_time_m"] == log["least_clearance_m"] <= log["d_T"].min()
    assert 0.0 <= result["gusts_within"] <= 1.0
    assert result["steady_wind_within"] == log["steady_wind_within"]


@pytest.mark.slow
def test_a_campaign_in_a_world_is_the_same_on_any_workers(tmp_path):
    study = Study(world=World.load("world", "hard"), trials=4, duration_s=0.5, modes=("robust",))
    for workers in (1, 2):
        fly_campaign(study, tmp_path / str(workers), workers)
    one, two = (rows_of(tmp_path / str(workers)) for workers in (1, 2))
    pd.testing.assert_frame_equal(one, two)
    assert (one["min_clearance_any_time_m"] <= one["min_clearance_m"] + 1e-6).all()


def test_a_row_of_every_plant_step_is_that_of_its_flight():
    study = Study(world=World.load("world", "field"), duration_s=6.0, modes=("offset_free",))
    row, scenario = fly_trial(study, 1, "offset_free"), study.scenario(1)
    log = fly(scenario, Controller(study.controller, "offset_free"), 6.0)
    off = log.d_T - 0.35
    assert row["status"] == "flown", row["error"]
    assert row["min_clearance_any_time_m"] == pytest.approx(log.least_clearance_m, abs=1e-6)
    assert row["violated_any_time"] == (log.least_clearance_m < 0.2)
    assert row["mean_clearance_m"] == pytest.approx(log.d_T.mean(), abs=1e-6)
    assert row["radial_rms_settled_m"] == pytest.approx(np.sqrt((off[200:] ** 2).mean()), abs=1e-6)


def test_a_campaign_of_before_is_read_and_tells_what_it_had(flown, tmp_path):
    (tmp_path / "study.json").write_bytes((flown / "study.json").read_bytes())
    rows = pd.read_csv(flown / "trials.csv")
    rows.drop(columns=list(ADDED_COLUMNS)).to_csv(tmp_path / "trials.csv", index=False)

    old, new = (summarise(read_trials(folder)) for folder in (tmp_path, flown))

    for mode in new:
        gone = {key for key in new[mode] if key not in old[mode]}
        assert gone == {
            "violations_any_time", "min_clearance_any_time_m", "mean_clearance_m",
            "radial_rms_settled_m", "min_airframe_clearance_m",
        }  # fmt: skip
        assert {k: v for k, v in new[mode].items() if k not in gone} == old[mode]
    assert without_times(old)


def test_vertices_meet_the_gusts_that_are_worst_for_the_mode_that_flies():
    study = Study.parse(
        {"plan": {"kind": "vertices"}, "gust": {"kind": "l1"}, "duration_s": 0.5}, "study"
    )
    robust = study.against("robust").gust.sequence
    assert robust == l1_sequence(study.controller, "robust")
    assert robust != study.against("offset_free").gust.sequence
    row = fly_trial(study, 0, "robust")
    assert row["status"] == "flown", row["error"]
    given = Study.parse({"gust": {"kind": "l1", "sequence": [1.0]}}, "study")
    assert given.against("robust") is given
    with pytest.raises(ConfigError, match="gust 'l1' against Holds: it is known for nominal"):
        worst_gusts(study.controller, "Holds")


def test_worst_gusts_against_an_own_controller_are_refused_before_anything_is_written(
    tmp_path, refused
):
    file = tmp_path / "own.py"
    file.write_text(HOLDS)
    own, out = f"{file}:Holds", tmp_path / "out"
    reason = "gust 'l1' against Holds"
    assert reason in refused("fly", "--gust", "l1", "--controller", own)
    assert reason in refused("campaign", "--gust", "l1", "--controller", own, "--out", out)
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--world", "moon"], "world = 'moon': there is field, hard, paper, or a YAML file"),
        (["--d-ref", 0], "--d-ref = 0: offset_m = 0.0: Input should be greater than 0"),
        (["--d-ref", "nan"], "--d-ref = nan: offset_m = nan"),
    ],
)
@pytest.mark.parametrize("command", ["fly", "campaign"])
def test_what_cannot_be_flown_is_refused_in_one_line(command, arguments, told, refused, tmp_path):
    into = ["--out", tmp_path / "out"] if command == "campaign" else []
    assert told in refused(command, *arguments, *into)
