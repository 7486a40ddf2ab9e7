# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Controllers fly the same flights; what one of them does wrong is in its rows, nowhere else."""

import csv
import json
import shutil

import numpy as np
import pandas as pd
import pytest
from support import arena_runs
from support.arena_runs import OWN, plan, without_times

from gtmr_study.arena import flight
from gtmr_study.arena.page import write_arena
from gtmr_study.arena.plan import Cell
from gtmr_study.arena.run import fly_arena
from gtmr_study.arena.table import candidates, closest, is_flown, results_of
from gtmr_study.result_files import InputError
from gtmr_study.rivals import catalogue
from gtmr_study.rivals.catalogue import RIVALS

pytestmark = pytest.mark.slow

KEYS = {
    "controller", "world", "d_ref_m", "trials", "violations", "min_clearance_m",
    "mean_clearance_m", "radial_rms_settled_m", "u_rms_hz_s", "step_ms",
}  # fmt: skip


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Folder, plan, own controllers and rows of an arena that is flown once."""
    folder = tmp_path_factory.mktemp("arena")
    return folder / "out", *arena_runs.flown_in(folder)


def test_every_flight_has_its_row_in_the_order_of_the_plan(flown):
    _, arena, _, rows = flown
    named = zip(rows["controller"], rows["world"], rows["d_ref_m"], rows["trial"], strict=True)
    assert list(named) == [(*cell, trial) for cell in arena.cells() for trial in range(3)]
    assert (rows["status"] == "flown").sum() == 3 * 4 * 3


def test_the_rows_are_the_same_for_any_number_of_workers(flown, tmp_path):
    folder, *_ = flown
    arena_runs.flown_in(tmp_path, workers=1)
    pd.testing.assert_frame_equal(without_times(tmp_path / "out"), without_times(folder))


def test_an_arena_that_was_killed_goes_on(flown, tmp_path):
    folder, arena, own, _ = flown
    out = shutil.copytree(folder, tmp_path / "out")
    lines = (folder / "flights.csv").read_text().splitlines(keepends=True)
    (out / "flights.csv").write_text("".join(lines[:8]) + lines[20][:9])
    kept = lines[1:8]

    told = []
    fly_arena(arena, out, own, 1, on_progress=lambda done, total: told.append((done, total)))

    again = (out / "flights.csv").read_text().splitlines(keepends=True)
    assert told[0] == (7, 72)
    assert told[-1] == (72, 72)
    assert again[1:8] == kept
    pd.testing.assert_frame_equal(without_times(out), without_times(folder))


def test_all_meet_the_same_mismatch_gusts_and_noise(flown):
    _, arena, _, rows = flown
    assert rows[rows["status"] == "flown"].groupby("trial")["seed"].nunique().tolist() == [1] * 3
    ours, farther = (arena.study("hard", d).scenario(2) for d in arena.d_ref_m)
    paper = arena.study("paper", 0.25).scenario(2)
    assert ours.zeta == farther.zeta == paper.zeta
    assert ours.seed == farther.seed == paper.seed
    assert ours.guard == "hold"
    assert arena.study("hard", 0.25).controller.tower == paper.tower
    assert arena.study("hard", 0.35).controller.helix.offset_m == 0.35


def test_a_controller_that_fails_has_its_rows_with_the_reason(flown):
    _, arena, _, rows = flown
    results = results_of(arena, rows)
    said = {"Nan": "nan among", "Raises": "ZeroDivisionError", "Late": "allowed is 30 ms"}
    for name, reason in said.items():
        cells = [result for result in results if result["controller"] == name]
        assert len(cells) == 4
        for cell in cells:
            assert (cell["trials"], cell["errors"], cell["violations"]) == (0, 3, 0)
            assert cell["violations_95"] == [0.0, 1.0]
            assert reason in cell["reason"]
            assert not is_flown(cell)
    late = rows[rows["controller"] == "Late"]
    assert set(late["status"]) == {"stopped", "left out"}
    assert late[late["trial"] == 0]["steps"].between(1, 19).all()
    assert (late[late["trial"] == 0]["step_ms_median"] > 30.0).all()
    told = next(result for result in results if result["controller"] == "Late")
    assert "of 20 steps" in told["reason"]
    assert told["step_ms"] > 30.0


def test_results_say_what_the_rows_say(flown):
    _, arena, _, rows = flown
    results = results_of(arena, rows)
    assert [Cell(r["controller"], r["world"], r["d_ref_m"]) for r in results] == arena.cells()
    for result in results:
        own = rows[
            (rows["controller"] == result["controller"])
            & (rows["world"] == result["world"])
            & (rows["d_ref_m"] == result["d_ref_m"])
        ]
        assert set(result) >= KEYS
        assert json.loads(json.dumps(result, allow_nan=False)) == result
        if not result["errors"]:
            least, mean = own["min_clearance_any_time_m"], own["mean_clearance_m"]
            assert result["min_clearance_m"] == least.min()
            assert result["mean_clearance_m"] == pytest.approx(mean.mean())
            assert result["violations"] == (least < 0.2).sum()
            assert result["flies_d_ref"] == (abs(mean.mean() - result["d_ref_m"]) <= 0.02)
            # No flight is long enough to have settled.
            assert result["radial_rms_settled_m"] is None
            assert result["missing"] == 0


def test_effort_and_tracking_are_those_of_the_flight(tmp_path):
    arena = plan(duration_s=6.0, trials=1)
    cell = Cell("nominal", "paper", 0.35)
    row = flight.fly_one(arena, cell, 0, {})
    study = arena.study("paper", 0.35)
    scenario = study.scenario(0)
    log = flight.fly(scenario, RIVALS["nominal"].make(study.controller, scenario), 6.0)
    assert row["u_rms_hz_s"] == pytest.approx(np.sqrt(np.mean(log.u**2)), abs=1e-4)
    off_m = log.d_T[log.t >= 5.0] - 0.35
    assert row["radial_rms_settled_m"] == pytest.approx(np.sqrt(np.mean(off_m**2)), abs=1e-6)


def test_those_that_are_slow_fly_their_share_of_the_trials(monkeypatch):
    rival = catalogue.Rival("slow", RIVALS["nominal"].make, trials=0.1)
    monkeypatch.setitem(RIVALS, "slow", rival)
    arena = plan(controllers=("nominal", "slow"), trials=50)
    assert (arena.trials_of("nominal"), arena.trials_of("slow")) == (50, 5)
    assert plan(controllers=("slow",), trials=2).trials_of("slow") == 1


def cell_result(controller, d_ref_m, **other):
    told = {
        "controller": controller, "world": "paper", "d_ref_m": d_ref_m, "trials": 9,
        "violations": 0, "errors": 0, "missing": 0, "flies_d_ref": True,
        "radial_rms_settled_m": 0.01,
    }  # fmt: skip
    return told | other


def test_who_flies_closest_is_taken_and_an_error_or_a_violation_never_wins():
    results = [
        cell_result("oracle", 0.21),
        cell_result("broken", 0.21, errors=1),
        cell_result("bold", 0.21, violations=1),
        cell_result("shy", 0.21, flies_d_ref=False),
        cell_result("cut", 0.21, missing=2),
        cell_result("none", 0.21, trials=0),
        cell_result("rough", 0.25, radial_rms_settled_m=0.05),
        cell_result("fine", 0.25),
        cell_result("fine", 0.30),
    ]
    assert candidates(results, "paper") == [results[7], results[6]]
    found = closest(results, "paper")
    assert list(found)[:3] == ["oracle", "fine", "rough"]
    assert {name for name, best in found.items() if best is None} == {
        "broken", "bold", "shy", "cut", "none",
    }  # fmt: skip
    assert candidates(results[:6], "paper") == []


def test_who_flew_too_few_trials_to_tell_is_not_taken():
    few, many = cell_result("slow", 0.21, trials=34), cell_result("fine", 0.25, trials=200)
    enough = few | {"trials": 35}
    assert candidates([few, many], "paper") == [many]
    assert candidates([enough, many], "paper") == [enough, many]
    assert candidates([cell_result("quick", 0.21, trials=4)], "paper")[0]["trials"] == 4
    assert list(closest([few, many], "paper")) == ["slow", "fine"]


def test_the_worst_flights_fly_again_by_their_commands(flown, tmp_path, gtmr):
    folder, _, own, rows = flown
    out = shutil.copytree(folder, tmp_path / "out")
    write_arena(out, own)
    file = f"{own[0].path}:Still"
    for cell, more in (("offset_free-0.25", ()), ("Still-0.35", ("--controller", file))):
        scenario = next((out / "worst" / "hard").glob(f"{cell}-*.yaml"))
        told = tmp_path / "told.json"
        ended = gtmr("fly", "--scenario", scenario, *more, "--json", told)
        assert ended.returncode == 0, ended.stderr
        controller, d_ref_m, trial = scenario.stem.rsplit("-", 2)
        row = rows[
            (rows["controller"] == controller)
            & (rows["world"] == "hard")
            & (rows["d_ref_m"] == float(d_ref_m))
        ].set_index("trial").loc[int(trial)]  # fmt: skip
        again = json.loads(told.read_text())["min_clearance_any_time_m"]
        assert again == pytest.approx(row["min_clearance_any_time_m"], abs=1e-6)


def test_a_scenario_needs_its_own_controller_and_no_other(flown, tmp_path, refused):
    folder, _, own, _ = flown
    out = shutil.copytree(folder, tmp_path / "out")
    write_arena(out, own)
    still = next((out / "worst" / "paper").glob("Still-0.35-*.yaml"))
    assert "--controller file.py:Still" in refused("fly", "--scenario", still)
    named = f"{own[0].path}:Nan"
    assert "is of Still" in refused("fly", "--scenario", still, "--controller", named)
    assert "says it all" in refused("fly", "--scenario", still, "--controller", "field")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--controllers", "bold"), "--controllers = 'bold': allowed is .*nominal"),
        (("--controllers", "nominal,nominal"), "nominal is named twice"),
        (("--controllers", "missing.py:Mine"), "No such file"),
        (("--controllers", "missing.py"), "expected missing.py:Class"),
        (("--worlds", "calm"), "world = 'calm'"),
        (("--worlds", "hard,hard"), "'hard' is named twice"),
        (("--d-ref", "near"), "--d-ref = near: expected distances"),
        (("--d-ref", "-0.3"), "-0.3"),
        (("--trials", 0), "--trials"),
        (("--seed", -1), "--seed"),
        (("--workers", 1, "--scheduler", "tcp://127.0.0.1:1"), "give one of them"),
        (("--scheduler", "tcp://127.0.0.1:1"), "no Dask scheduler answers"),
    ],
)
def test_what_cannot_be_flown_is_refused_and_leaves_nothing(refused, tmp_path, arguments, said):
    out = tmp_path / "out"
    line = refused("arena", "--quick", *arguments, "--out", out)
    assert pd.Series(line).str.contains(said).all(), line
    assert not out.exists()


def test_another_plan_in_the_same_folder_is_refused(flown, tmp_path, refused):
    folder, arena, own, _ = flown
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    for change in ({"seed": 5}, {"trials": 4}, {"d_ref_m": (0.25,)}):
        with pytest.raises(InputError, match=f"holds another arena, with {next(iter(change))}"):
            fly_arena(arena.model_copy(update=change), folder, own, 1)
    assert "holds another arena" in refused("arena", "--quick", "--out", folder)
    (tmp_path / "mine.txt").write_text("mine")
    assert "holds mine.txt but no arena" in refused("arena", "--quick", "--out", tmp_path)
    after = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    assert after == before


def test_a_class_called_like_a_controller_of_the_arena_is_refused(refused, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("class nominal: pass\nclass A: pass\nclass " + "oracle: pass\n")
    assert "no name of a class" in refused("arena", "--controllers", f"{file}:nominal", "--out",
                                           tmp_path / "out")  # fmt: skip
    assert "cannot be made" in refused(
        "arena", "--quick", "--controllers", f"{file}:A", "--out", tmp_path / "out"
    )
    assert not (tmp_path / "out").exists()


def test_one_command_flies_a_class_of_ones_own_among_others(gtmr, tmp_path):
    own = arena_runs.own_controllers(tmp_path)
    out, told = tmp_path / "out", tmp_path / "told.json"
    named = f"{own[0].path}:Still,nominal,{own[0].path}:Nan"
    arguments = ("--worlds", "paper", "--d-ref", "0.35,0.3", "--trials", 1, "--workers", 1)
    ended = gtmr("arena", "--quick", "--controllers", named, *arguments, "--out", out,
                 "--json", told)  # fmt: skip

    assert ended.returncode == 0, ended.stderr
    assert "World paper" in ended.stdout
    assert ended.stderr.count("Nan in paper at") == 2
    results = json.loads(told.read_text())
    assert results == json.loads((out / "arena.json").read_text())
    assert [r["controller"] for r in results] == ["nominal"] * 2 + ["Nan"] * 2 + ["Still"] * 2
    assert {r["d_ref_m"] for r in results} == {0.3, 0.35}
    files = {path.name for path in out.iterdir()}
    assert files >= {"arena.html", "arena.json", "flights.csv", "plan.json"}
    assert {path.suffix for path in out.glob("clearance-against-tracking.*")} == {".png", ".svg"}
    with (out / "flights.csv").open() as rows:
        assert next(csv.reader(rows)) == list(flight.COLUMNS)


def test_all_of_the_arena_fly_if_nobody_is_named():
    from gtmr_study.arena.plan import named_controllers

    names, own = named_controllers("--controllers", None)
    assert (names, own) == (list(RIVALS), [])
    assert set(OWN).isdisjoint(RIVALS)


def test_a_flight_is_stopped_by_its_steps_not_by_its_start(monkeypatch):
    times = iter([100.0, 100.5, 101.0, 101.5])
    monkeypatch.setattr(flight.time, "perf_counter", lambda: next(times))
    clock = flight._Clock(plan(step_budget_ms=20.0, patience_s=1.2))
    # A loop in C tells of 40 steps at once.
    for steps in (40, 60, 80):
        clock(steps)
    assert (clock.steps, clock.mean_ms) == (80, pytest.approx(25.0))
    with pytest.raises(flight.StoppedFlight, match="20 ms"):
        clock(100)
