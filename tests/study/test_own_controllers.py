# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A class in a Python file flies by name on the command line, and only there."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from gtmr_study.campaign.run import fly_campaign
from gtmr_study.campaign.study import Study
from gtmr_study.campaign.trial import fly_trial
from gtmr_study.own_controller import OwnController
from gtmr_study.result_files import InputError

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[2] / "examples"
LQR, PID = EXAMPLES / "05_own_controller.py", EXAMPLES / "09_pid_controller.py"
BROKEN = """
import numpy as np
class Wrong:
    def __init__(self, config): self.n = config.vehicle.n_rotors
class Nan(Wrong):
    def step(self, t, x): return np.full(self.n, np.nan if t > 0.1 else 0.0)
class Raises(Wrong):
    def step(self, t, x): return [0.0] * self.n if t < 0.1 else 1 / 0
class Short(Wrong):
    def step(self, t, x): return np.zeros(2)
class NeedsMore:
    def __init__(self, config, gain): pass
class nominal(Nan):
    pass
"""


@pytest.fixture
def broken(tmp_path):
    file = tmp_path / "broken.py"
    file.write_text(BROKEN)
    return file


@pytest.mark.parametrize(("file", "name"), [(LQR, "Lqr"), (PID, "Pid")])
def test_gtmr_fly_flies_the_examples(gtmr, tmp_path, file, name):
    out, told = tmp_path / "f.npz", tmp_path / "f.json"
    arguments = ("--controller", f"{file}:{name}", "--duration", 2, "--out", out, "--json", told)
    ended = gtmr("fly", *arguments)

    assert ended.returncode == 0, ended.stderr
    result, log = json.loads(told.read_text()), np.load(out)
    assert result["mode"] == name
    assert result["max_slack_m"] is None
    assert result["failed_steps"] is None
    assert result["min_clearance_m"] == log["d_T"].min() > 0.3
    assert log["alpha_p"].shape == (80, 0)


@pytest.mark.parametrize("file", [LQR, PID], ids=lambda file: file.stem)
def test_a_controller_of_ones_own_takes_less_than_sixty_lines(file):
    lines = file.read_text(encoding="utf-8").splitlines()
    assert sum(not line.startswith("#") for line in lines) < 60


@pytest.mark.parametrize(("file", "name"), [(LQR, "Lqr"), (PID, "Pid")])
def test_a_campaign_and_its_report_take_it(gtmr, tmp_path, file, name):
    out, arguments = tmp_path / "out", ("--trials", 3, "--duration", 0.5, "--workers", 1)
    ended = gtmr("campaign", "--controller", f"{file}:{name}", *arguments, "--out", out)
    reported = gtmr("report", out, "--out", tmp_path / "report.html")

    assert ended.returncode == reported.returncode == 0, ended.stderr + reported.stderr
    rows = pd.read_csv(out / "trials.csv")
    assert list(rows["mode"]) == [name] * 3
    assert list(rows["status"]) == ["flown"] * 3
    assert rows[["max_slack_m", "failed_steps"]].isna().all(axis=None)
    summary = json.loads((out / "summary.json").read_text())[name]
    assert summary["trials"] == 3
    assert summary["failed_steps"] is None
    page = (tmp_path / "report.html").read_text()
    assert name in page
    assert "not told" in page
    assert "still missing" not in page


def test_a_controller_that_fails_has_the_reason_in_its_row(broken):
    reasons = {"Nan": "nan among", "Raises": "ZeroDivisionError", "Short": "shape (2,)"}
    for name, reason in reasons.items():
        own = OwnController.named("--controller", f"{broken}:{name}")
        row = fly_trial(Study(duration_s=0.5), 0, name, own)
        assert (row["mode"], row["status"]) == (name, "error")
        assert reason in row["error"]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("Missing", "has no class Missing: there is .*NeedsMore"),
        ("NeedsMore", "TypeError: .*gain"),
        ("Wrong", "has no step"),
        ("nominal", "no name of a class to fly"),
        ("", "no name of a class to fly"),
    ],
)
@pytest.mark.parametrize("command", ["fly", "campaign"])
def test_what_cannot_be_made_is_refused_in_one_line(
    refused, broken, tmp_path, command, name, told
):
    out = tmp_path / ("out" if command == "campaign" else "out.npz")
    said = refused(command, "--controller", f"{broken}:{name}", "--out", out)
    assert pd.Series(said).str.contains(told).all()
    assert not out.exists()


def test_a_file_that_is_not_there_or_does_not_run_is_refused(refused, tmp_path):
    assert "No such file" in refused("fly", "--controller", f"{tmp_path}/none.py:Lqr")
    (tmp_path / "wrong.py").write_text("class (:")
    assert "SyntaxError" in refused("fly", "--controller", f"{tmp_path}/wrong.py:Lqr")
    assert "expected none.py:Class" in refused("fly", "--controller", "none.py")
    assert "NaN" not in refused("fly", "--controller", f"{LQR}:Lqr", "--mode", "robust")


def test_a_step_that_cannot_be_flown_is_refused_in_one_line(refused, broken):
    assert "Short.step at t = 0 s" in refused("fly", "--controller", f"{broken}:Short")


def test_yaml_never_runs_a_file(refused, broken, tmp_path):
    broken.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n{BROKEN}")
    named = OwnController.named("--controller", f"{broken}:Nan").fingerprint.model_dump()
    studies = ({"controller": f"{broken}:Nan"}, {"own_controller": named})
    for k, study in enumerate(studies):
        (tmp_path / "study.yaml").write_text(yaml.safe_dump(study))
        refused("campaign", "--scenario", tmp_path / "study.yaml", "--out", tmp_path / str(k))
    assert not (tmp_path / "ran").exists()


def test_a_campaign_goes_on_only_with_the_same_text(broken, tmp_path):
    study = Study(trials=1, duration_s=0.5)
    option = ("--controller", f"{broken}:Nan")
    fly_campaign(study, tmp_path / "out", n_workers=1, own=OwnController.named(*option))
    broken.write_text(BROKEN + "# changed\n")

    with pytest.raises(InputError, match=r"own_controller.sha256"):
        fly_campaign(study, tmp_path / "out", n_workers=1, own=OwnController.named(*option))
