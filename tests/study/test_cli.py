# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command line: results, and one clear line with exit code 2 for bad input."""

import json
import re
import webbrowser
from contextlib import nullcontext
from importlib.metadata import version

import numpy as np
import pytest
from rich.console import Console
from rich.progress import Progress
from support.command_line import gtmr_process

from gtmr_nmpc import MODES, Controller
from gtmr_sim import FlightLog, Scenario, fly
from gtmr_study.campaign import run
from gtmr_study.campaign.study import Study
from gtmr_study.cli import bench as bench_module
from gtmr_study.cli import fly as fly_module
from gtmr_study.cli import replay as replay_module
from gtmr_study.cli import tables
from gtmr_study.cli.app import MODULES
from gtmr_study.cli.campaigns import campaign as campaign_module
from gtmr_study.cli.campaigns import faults as faults_module
from gtmr_study.faults.campaign import TITLES


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
    **{
        f"negative seed of {command}": (
            [command, "--seed", "-1", *more],
            "--seed = -1: allowed is 0 to",
        )
        for command, more in {
            "fly": [],
            "demo": [],
            "campaign": ["--out", "new"],
            "reproduce": [],
            "calibrate": ["--out", "new"],
            "attack": ["--out", "new"],
        }.items()
    },
    "too large a seed": (["fly", "--seed", str(2**63)], f"--seed = {2**63}: allowed"),
    "demo of unknown gust": (["demo", "--gust", "storm"], "--gust = 'storm'"),
    "demo of zeta outside": (
        ["demo", "--zeta", *["0.2", "0", "0", "0", "0", "0", "0", "0", "0"]],
        "zeta[mass] = 0.2",
    ),
    "demo of unknown world": (["demo", "--world", "mars"], "world = 'mars'"),
    "demo of unknown vehicle": (["demo", "--vehicle", "hexa"], "'hexa'"),
    "demo of unknown controller": (["demo", "--controller", "nope"], "controller = 'nope'"),
    "demo of an own controller": (
        ["demo", "--controller", "mine.py:A"],
        "--controller = mine.py:A: the demo flies the node",
    ),
    "report of no flight": (["report", "nowhere.npz"], "nowhere.npz: No such file"),
    "report of flights of a vehicle": (["report", "a.npz", "--vehicle", "hex1"], "--vehicle"),
    "report of flights and bags": (["report", "a.npz", "bag"], "give one kind"),
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


def test_fly_tells_tracking_error_and_slack(tmp_path, gtmr):
    out, flight = tmp_path / "flight.json", tmp_path / "flight.npz"
    run = gtmr("fly", "--duration", 1, "--sample", "--json", out, "--out", flight)
    assert run.returncode == 0, run.stderr
    result, log = json.loads(out.read_text()), FlightLog.load(flight)
    assert {**log.summary(), "world": "paper"} == result
    printed = {line[:32].strip(): line[32:].strip() for line in run.stdout.splitlines()}
    assert printed["tracking error, radial [m]"] == f"{result['radial_rms_m']:.3f}"
    assert printed["total [m]"] == f"{result['tracking_rms_m']:.3f}"
    slack = f"{result['max_slack_m']:.3f} in {result['softened_steps']}"
    assert printed["largest slack [m], steps"] == slack


def test_fly_reports_beside_the_flight_and_opens_nothing(tmp_path, gtmr, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flights").mkdir()
    beside = ("--out", "flights/one.npz")
    for more, page in ((beside, "flights/report.html"), ((), "report.html")):
        run = gtmr("fly", "--duration", 0.5, "--report", *more)
        assert run.returncode == 0, run.stderr
        assert "<h1" in (tmp_path / page).read_text(encoding="utf-8")
        assert f"Report: {page}" in run.stdout
    assert not opened


def test_fly_does_not_write_over_a_report(tmp_path, refused, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "report.html").write_text("keep me")
    said = refused("fly", "--duration", 0.5, "--report", "--out", "flight.npz")
    assert "report.html: exists already and is not overwritten" in said
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


OWN = """
from gtmr_nmpc import ControllerConfig


class Other:
    def __init__(self, config):
        self.config = ControllerConfig.parse({fields}, "mine")

    def step(self, t, x):
        raise NotImplementedError
"""
OTHERS = {
    "tower": ('{"tower": {"radius_m": 2.0}}', "tower.radius_m = 1.0: the controller is made for"),
    "vehicle": ('{"vehicle": "octo"}', "the controller is made for"),
    "T_s": ('{"sampling_time_s": 0.05}', "sampling_time_s = 0.025: the controller is made for"),
}


@pytest.mark.parametrize("what", OTHERS)
def test_a_controller_made_for_something_else_does_not_fly(what, tmp_path, refused):
    fields, told = OTHERS[what]
    (tmp_path / "mine.py").write_text(OWN.format(fields=fields))
    out = tmp_path / "flight.npz"
    controller = f"{tmp_path / 'mine.py'}:Other"
    assert told in refused("fly", "--duration", 0.1, "--controller", controller, "--out", out)
    assert not out.exists()


def test_flights_are_reported_side_by_side(tmp_path, gtmr):
    logs = {"nominal": Controller(mode="nominal"), "robust": Controller()}
    for name, controller in logs.items():
        fly(Scenario(), controller, 0.5).save(tmp_path / f"{name}.npz")
    paths = [tmp_path / f"{name}.npz" for name in logs]
    run = gtmr("report", *paths, "--out", tmp_path / "both.html")
    assert run.returncode == 0, run.stderr
    page = (tmp_path / "both.html").read_text(encoding="utf-8")
    assert all(name in page for name in logs)


def test_a_torn_flight_is_refused_in_one_line(tmp_path, refused):
    path = tmp_path / "flight.npz"
    fly(Scenario(), Controller(), 0.1).save(path)
    path.write_bytes(path.read_bytes()[:500])
    said = refused("report", path, "--out", tmp_path / "report.html")
    assert said == f"gtmr: {path}: is no npz file, or a broken one\n"


def test_version(gtmr):
    run = gtmr("--version")
    assert run.returncode == 0
    assert run.stdout == f"gtmr {version('gtmr')}\n"


def help_of(command, columns, monkeypatch, gtmr):
    monkeypatch.setenv("COLUMNS", str(columns))
    run = gtmr(command, "--help") if command else gtmr("--help")
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.mark.parametrize("columns", [55, 80, 120])
@pytest.mark.parametrize("command", ["", *MODULES])
def test_help_fits_the_terminal_and_is_not_cut(command, columns, monkeypatch, gtmr):
    text = help_of(command, columns, monkeypatch, gtmr)
    whole = help_of(command, 200, monkeypatch, gtmr)
    # However it is broken into lines.
    assert "".join(text.split()) == "".join(whole.split())
    assert not re.search(r"\w\.\.\.(\s|$)|…", text.replace("PATH...", "").replace("...]", ""))
    # What has no blank in it cannot be broken.
    longest = max(len(word) for word in text.split())
    assert max(map(len, text.splitlines())) <= max(columns, longest + 4)


TABLES = {
    "fly": fly_module.FLIGHT_WORDS,
    "demo": fly_module.FLIGHT_WORDS,
    "campaign": campaign_module.SUMMARY_WORDS,
    "reproduce": campaign_module.SUMMARY_WORDS,
    "replay": replay_module.REPLAY_WORDS,
    "faults": faults_module.WORDS,
    "bench": bench_module.WORDS,
}


@pytest.mark.parametrize("command", TABLES)
def test_help_explains_every_word_of_the_table(command, monkeypatch, gtmr):
    text = "".join(help_of(command, 100, monkeypatch, gtmr).split())
    for word, meaning in TABLES[command].items():
        assert "".join(word.split()) + "".join(meaning.split()) in text


def test_the_words_of_a_table_are_those_it_prints(gtmr):
    printed = gtmr("fly", "--duration", 0.1).stdout.splitlines()
    names = {line[:32].strip() for line in printed if line.strip() and "──" not in line}
    explained = {word.strip() for word in fly_module.FLIGHT_WORDS}
    assert names - {""} <= explained
    assert len(names) == len(fly_module.FLIGHT_ROWS) + 1
    assert set(TITLES) == set(faults_module.WORDS)
    assert set(bench_module.COLUMNS) <= set(bench_module.WORDS)


@pytest.mark.parametrize("columns", [60, 80, 120])
def test_tables_fit_the_terminal(columns, monkeypatch, capsys):
    monkeypatch.setattr(tables, "console", Console(width=columns))
    result = json.loads(json.dumps(fly(Scenario(), Controller(), 0.1).summary()))
    tables.print_rows(fly_module.FLIGHT_ROWS, dict.fromkeys(MODES, result))
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= columns
    assert not any("…" in line for line in lines)
    if columns >= 80:
        assert len([line for line in lines if line.strip()]) == len(fly_module.FLIGHT_ROWS) + 2


@pytest.mark.parametrize("columns", [80, 120])
def test_no_name_in_a_table_is_cut(columns, monkeypatch, capsys):
    monkeypatch.setattr(tables, "console", Console(width=columns))
    name, sentence = "bag-odometry-undecodable", "what is read was written, or it is said " * 3
    table = tables.new_table(*TITLES)
    table.columns[0].no_wrap = True
    table.add_row(name, sentence, "100 of 100", "96.3 to 100.0 %", "0.20 m", "12.25 s")
    tables.console.print(table)
    printed = capsys.readouterr().out
    assert name in printed
    assert "…" not in printed
    assert "".join(sentence.split()[-1:]) in printed


def test_progress_starts_with_the_total(monkeypatch):
    started = []

    class Bar(Progress):
        def add_task(self, description, **given):
            started.append((description, given.get("total"), given.get("completed", 0)))
            return super().add_task(description, **given)

    monkeypatch.setattr(campaign_module, "progress", lambda *_: Bar(disable=True))
    with campaign_module.reported_progress() as show:
        show("flights", 3, 8)
        show("flights", 4, 8)
    assert started == [("flights", 8, 3)]


def test_a_campaign_tells_its_total_before_it_flies(tmp_path, monkeypatch):
    told = []

    def nobody(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(run.cluster, "local_threads", lambda *_: nullcontext())
    monkeypatch.setattr(run.cluster, "fly_on", lambda *_: iter(()))
    monkeypatch.setattr(run, "summarise", nobody)
    with pytest.raises(KeyboardInterrupt):
        run.fly_campaign(
            Study(trials=3), tmp_path / "out", on_progress=lambda *of: told.append(of)
        )
    assert told[0] == (0, 6)


def test_report_of_what_is_no_bag_ends_the_process_with_one_line(tmp_path):
    path = tmp_path / "flight.mcap"
    path.write_text("not a bag")
    run = gtmr_process("report", path, cwd=tmp_path)
    assert run.returncode == 2
    assert "flight.mcap" in run.stderr
    assert run.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("bench", "--steps", "3"), "gtmr: --steps = 3: Input should be greater than"),
        (("campaign", "--trials", "many", "--out", "x"), "gtmr: --trials = many: Input should be"),
    ],
)
def test_a_refused_number_is_named_with_its_option(refused, given, said):
    assert refused(*given).startswith(said)
