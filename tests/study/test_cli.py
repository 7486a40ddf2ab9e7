# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command line: results, and one clear line with exit code 2 for bad input."""

import json

import numpy as np
import pytest
from support.command_line import gtmr_process


def test_fly_writes_what_it_prints(tmp_path):
    zeta = [0.05, 0, 0, 0, -0.05, 0, 0.6, 0.4, 0]
    npz, out = tmp_path / "flight.npz", tmp_path / "flight.json"
    run = gtmr_process(
        *("fly", "--mode", "nominal", "--seed", 3, "--duration", 1, "--gust", "dryden"),
        *("--zeta", *zeta, "--out", npz, "--json", out),
    )
    assert run.returncode == 0, run.stderr
    log, result = np.load(npz), json.loads(out.read_text())
    named = {"t", "x", "u", "zeta", "w_g", "d_T", "alpha_p", "alpha_g", "slack", "solve_ms"}
    assert named | {"d_airframe"} <= set(log)
    np.testing.assert_array_equal(log["zeta"], zeta)
    assert len(log["t"]) == result["samples"] == 40
    assert result["min_clearance_m"] == pytest.approx(log["d_T"].min())
    assert result["min_airframe_clearance_m"] == pytest.approx(log["d_airframe"].min())
    assert f"{result['min_clearance_m']:.3f}" in run.stdout


def test_fly_sample_draws_zeta_by_the_seed(tmp_path, gtmr):
    drawn = []
    for name in ("a", "b"):
        out = tmp_path / f"{name}.json"
        run = gtmr("fly", "--sample", "--seed", 4, "--duration", 0.1, "--json", out)
        assert run.returncode == 0, run.stderr
        drawn.append(json.loads(out.read_text())["zeta"])
    assert drawn[0] == drawn[1]
    assert any(drawn[0])


BAD = {
    "unknown mode": (["fly", "--mode", "robst"], "--mode = 'robst'"),
    "unknown gust": (["fly", "--gust", "storm"], "--gust = 'storm'"),
    "zeta outside": (
        ["fly", "--zeta", *["0.2", "0", "0", "0", "0", "0", "0", "0", "0"]],
        "zeta[mass] = 0.2",
    ),
    "zeta too short": (["fly", "--zeta", "0", "0"], "--zeta"),
    "zeta twice": (
        ["fly", "--sample", "--zeta", *["0", "0", "0", "0", "0", "0", "0", "0", "0"]],
        "--sample",
    ),
    "negative duration": (["fly", "--duration", "-1"], "--duration = -1"),
    "no duration": (["fly", "--duration", "nan"], "--duration = nan"),
    "negative seed": (["fly", "--seed", "-1"], "seed = -1"),
    "unknown vehicle": (["fly", "--vehicle", "hexa"], "'hexa'"),
    "missing vehicle file": (["fly", "--vehicle", "nowhere.yaml"], "nowhere.yaml"),
    "out of no kind": (["fly", "--out", "flight.csv"], "flight.csv"),
    "out in no folder": (["fly", "--out", "nowhere/flight.npz"], "nowhere"),
    "unknown option": (["fly", "--fast"], "--fast"),
    "unknown command": (["flight"], "flight"),
    "demo of unknown mode": (["demo", "--modes", "nominal,fast"], "--modes = 'fast'"),
    "demo of a mode twice": (["demo", "--modes", "robust,robust"], "--modes"),
    "demo of negative duration": (["demo", "--duration", "-5"], "--duration = -5"),
    "export to where nothing can be": (["export-c", "/proc/nowhere"], "DIR = /proc/nowhere: "),
    "report of nothing": (["report", "nowhere"], "nowhere"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_gets_one_clear_line(case, tmp_path, monkeypatch, refused):
    arguments, named = BAD[case]
    monkeypatch.chdir(tmp_path)
    assert named in refused(*arguments)
    assert list(tmp_path.iterdir()) == []


def test_vehicle_file_with_a_wrong_field_names_it(tmp_path, refused):
    path = tmp_path / "mine.yaml"
    path.write_text("mass_kg: heavy\n")
    said = refused("fly", "--vehicle", path)
    assert "mass_kg = 'heavy'" in said
    assert "rotors is missing" in said


def test_nothing_is_overwritten(tmp_path, refused):
    npz, folder = tmp_path / "flight.npz", tmp_path / "demo"
    folder.mkdir()
    (folder / "notes.txt").write_text("keep me")
    npz.write_text("keep me")
    for arguments in (["fly", "--out", npz], ["demo", "--out", folder]):
        assert "not overwritten" in refused(*arguments)
    assert npz.read_text() == (folder / "notes.txt").read_text() == "keep me"


def test_report_of_what_is_no_bag_ends_the_process_with_one_line(tmp_path):
    path = tmp_path / "flight.mcap"
    path.write_text("not a bag")
    run = gtmr_process("report", path, cwd=tmp_path)
    assert run.returncode == 2
    assert "flight.mcap" in run.stderr
    assert run.stderr.count("\n") == 1
