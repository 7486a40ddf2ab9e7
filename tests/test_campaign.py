# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""A campaign ends with the same results however it is cut up, killed, or where it runs."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gtmr_nmpc import Controller
from gtmr_sim import FlightLog, fly
from gtmr_study import cli, cluster, trial
from gtmr_study.campaign import fly_campaign
from gtmr_study.campaign_figures import FIGURES, Campaign
from gtmr_study.campaign_report import write_campaign_report
from gtmr_study.result_files import InputError
from gtmr_study.study import Study
from gtmr_study.summary import channel_shares, summarise, wilson_interval
from gtmr_study.trial import COLUMNS, QUANTILE_COLUMNS, fly_trial
from gtmr_study.trials_file import ResultsError, open_campaign, read_trials

DEADLINE_S = 60.0
TIMES = ["solve_ms_mean", "solve_ms_median", "solve_ms_p99"]
ARGUMENTS = ("--trials", 6, "--seed", 5, "--duration", 0.5, "--workers", 2)


def command(*arguments):
    return [sys.executable, "-m", "gtmr_study.cli", *map(str, arguments)]


def gtmr(*arguments, **options):
    return subprocess.run(
        command(*arguments), capture_output=True, text=True, timeout=120, check=False, **options
    )


@pytest.fixture
def refused(monkeypatch, capsys):
    """Run a command that is to be refused, in this process, and return its one line."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["gtmr", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        out, err = capsys.readouterr()
        assert ended.value.code == 2, err
        assert out == ""
        assert err.count("\n") == 1
        return err

    return run


def wait_for(condition):
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def rows_of(folder):
    return pd.read_csv(folder / "trials.csv").drop(columns=TIMES)


def without_times(summary):
    return {mode: {k: v for k, v in s.items() if k != "solve_ms"} for mode, s in summary.items()}


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign") / "out"
    run = gtmr("campaign", *ARGUMENTS, "--out", folder, "--json", folder.parent / "s.json")
    assert run.returncode == 0, run.stderr
    return folder


@pytest.fixture(scope="module")
def summary(flown):
    return json.loads((flown / "summary.json").read_text())


def test_one_row_per_trial_and_mode_in_order(flown):
    trials = pd.read_csv(flown / "trials.csv")

    assert tuple(trials.columns) == COLUMNS
    assert list(zip(trials["trial"], trials["mode"], strict=True)) == [
        (k, mode) for k in range(6) for mode in ("nominal", "robust")
    ]
    assert (trials["status"] == "flown").all()


def test_modes_see_the_same_mismatch_and_the_same_seed(flown):
    trials = pd.read_csv(flown / "trials.csv").set_index(["trial", "mode"])
    given = trials[["seed", "mass", "J_x", "J_y", "J_z", "thrust", "drag", "w_bx", "w_by", "w_bz"]]

    nominal, robust = (given.xs(mode, level="mode") for mode in ("nominal", "robust"))

    pd.testing.assert_frame_equal(nominal, robust)
    assert nominal["seed"].is_unique


def test_modes_meet_the_same_gusts():
    scenario = Study(seed=5).scenario(0)

    gusts = [fly(scenario, Controller(mode=mode), 0.5).w_g for mode in ("nominal", "robust")]

    np.testing.assert_array_equal(*gusts)


def test_every_summary_figure_is_recomputed_from_the_csv_by_plain_pandas(flown, summary):
    trials = pd.read_csv(flown / "trials.csv")
    assert set(summary) == {"nominal", "robust"}
    for mode, s in summary.items():
        rows = trials[(trials["mode"] == mode) & (trials["status"] == "flown")]
        pooled = rows[[c for c in rows if c.startswith("residual_") and c[9].isdigit()]].stack()
        assert s.pop("violation_rate_95") == list(
            wilson_interval(int(rows["violated"].sum()), len(rows))
        )
        assert s == {
            "trials": len(rows),
            "errors": 0,
            "violations": rows["violated"].sum(),
            "violation_rate": rows["violated"].mean(),
            "min_clearance_m": rows["min_clearance_m"].min(),
            "median_clearance_m": rows["d_min_m"].iloc[0] - pooled.quantile(0.5),
            "residual_m": {
                "min": rows["residual_min_m"].min(),
                "q1": pooled.quantile(0.25),
                "median": pooled.quantile(0.5),
                "q3": pooled.quantile(0.75),
                "max": rows["residual_max_m"].max(),
            },
            "radial_rms_m": (rows["radial_rms_m"] ** 2).mean() ** 0.5,
            "solve_ms": {
                "mean": rows["solve_ms_mean"].mean(),
                "median": rows["solve_ms_median"].median(),
                "p99": rows["solve_ms_p99"].median(),
            },
            "failed_steps": rows["failed_steps"].sum(),
        }
    again = json.loads((flown.parent / "s.json").read_text())
    assert without_times(again)["robust"]["trials"] == 6


def test_a_row_is_the_flight_of_its_seed(flown):
    row = pd.read_csv(flown / "trials.csv").iloc[3]
    scenario = Study(seed=5).scenario(1)

    log = fly(scenario, Controller(mode="robust"), 0.5)

    assert (row["trial"], row["mode"], row["seed"]) == (1, "robust", scenario.seed)
    assert row["min_clearance_m"] == pytest.approx(log.d_T.min(), abs=1e-6)
    assert row["residual_max_m"] == pytest.approx(0.2 - log.d_T.min(), abs=1e-6)


def test_one_worker_and_another_order_of_modes_give_the_same_rows(flown, tmp_path):
    arguments = [*ARGUMENTS[:-1], 1, "--modes", "robust,nominal"]

    run = gtmr("campaign", *arguments, "--out", tmp_path / "out")

    assert run.returncode == 0, run.stderr
    pd.testing.assert_frame_equal(rows_of(tmp_path / "out"), rows_of(flown))


def test_chunks_hold_every_flight_once():
    flights = Study(trials=500).flights()

    for duration_s in (0.1, 1.0, 50.0, 5000.0):
        chunks = list(cluster.chunked(flights, duration_s))
        assert [flight for chunk in chunks for flight in chunk] == flights
        assert max(map(len, chunks)) <= cluster.LARGEST_CHUNK


def test_what_a_worker_flew_before_does_not_matter():
    study = Study(seed=5, duration_s=0.5)
    fresh = fly_trial(study, 1, "robust")

    fly_trial(study, 0, "nominal")
    again = fly_trial(study, 1, "robust")

    assert {k: v for k, v in again.items() if k not in TIMES} == {
        k: v for k, v in fresh.items() if k not in TIMES
    }


def test_killed_at_any_moment_it_goes_on_and_loses_no_finished_trial(flown, summary, tmp_path):
    folder = tmp_path / "out"
    arguments = ("campaign", *ARGUMENTS, "--out", folder)
    killed = subprocess.Popen(
        command(*arguments), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True,
    )  # fmt: skip
    wait_for((folder / "trials.csv").exists)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    kept = (folder / "trials.csv").read_text()
    # As if it had been killed in the middle of a line.
    done = (flown / "trials.csv").read_text().splitlines(keepends=True)
    lines = [*(kept.splitlines(keepends=True) or done[:1]), done[5], done[8][:40]]
    (folder / "trials.csv").write_text("".join(lines))
    finished = (folder / "trials.csv").read_text().count("\n")

    again = gtmr(*arguments)

    assert again.returncode == 0, again.stderr
    assert finished >= 2
    assert done[5] in (folder / "trials.csv").read_text()
    pd.testing.assert_frame_equal(rows_of(folder), rows_of(flown))
    ended = json.loads((folder / "summary.json").read_text())
    assert without_times(ended) == without_times(json.loads((flown / "summary.json").read_text()))


def test_a_finished_campaign_started_again_flies_nothing(flown, monkeypatch):
    before = (flown / "trials.csv").read_bytes()
    monkeypatch.setattr(cluster, "local_workers", None)

    fly_campaign(Study(trials=6, seed=5, duration_s=0.5), flown)

    assert (flown / "trials.csv").read_bytes() == before


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


def test_a_scheduler_that_is_not_there_is_said_within_ten_seconds(tmp_path, refused):
    address, start = "tcp://127.0.0.1:9", time.monotonic()

    said = refused("campaign", "--scheduler", address, "--out", tmp_path / "out")

    assert time.monotonic() - start < 10.0
    assert f"--scheduler = {address}" in said
    assert not (tmp_path / "out").exists()


@pytest.fixture
def scheduler(tmp_path):
    """A Dask scheduler and two workers as processes of their own."""
    file = tmp_path / "scheduler.json"
    at = ("--scheduler-file", str(file))
    start = [sys.executable, "-m", "dask"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    server = [*start, "scheduler", *at, "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    processes = [subprocess.Popen(server, **quiet)]
    wait_for(lambda: file.exists() and file.read_text().endswith("}"))
    for _ in range(2):
        worker = [*start, "worker", *at, "--nthreads", "1", "--no-dashboard"]
        processes.append(subprocess.Popen(worker, cwd=tmp_path, **quiet))
    yield json.loads(file.read_text())["address"], processes
    for process in reversed(processes):
        process.terminate()
    for process in processes:
        process.wait(20)


def test_a_running_scheduler_gives_the_same_rows_even_if_a_worker_is_killed(
    flown, scheduler, tmp_path
):
    address, processes = scheduler
    arguments = [*ARGUMENTS[:-2], "--scheduler", address, "--out", tmp_path / "out"]
    run = subprocess.Popen(
        command("campaign", *arguments), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    wait_for((tmp_path / "out" / "trials.csv").exists)

    processes[-1].kill()

    _, problems = run.communicate(timeout=120)
    assert run.returncode == 0, problems.decode()
    pd.testing.assert_frame_equal(rows_of(tmp_path / "out"), rows_of(flown))


def test_a_trial_that_raises_is_reported_in_its_row(monkeypatch):
    def fails(*_):
        raise ArithmeticError("lost\nthe tower")

    monkeypatch.setattr(trial, "fly", fails)

    row = fly_trial(Study(), 3, "robust")

    assert (row["status"], row["error"]) == ("error", "ArithmeticError: lost the tower")
    assert row["seed"] == Study().scenario(3).seed
    assert row["min_clearance_m"] == ""


def test_trials_that_raised_are_counted_apart(flown, tmp_path):
    trials = pd.read_csv(flown / "trials.csv")
    lost = pd.DataFrame([trial.empty_row(6, "robust") | {"status": "error", "error": "lost"}])
    both = tmp_path / "trials.csv"
    pd.concat([trials, lost]).to_csv(both, index=False)

    summed = summarise(pd.read_csv(both))

    assert summed["robust"]["trials"] == 6
    assert summed["robust"]["errors"] == 1
    assert summed["nominal"]["errors"] == 0


def test_a_full_disk_is_said_and_finished_trials_are_kept(flown, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "study.json").write_bytes((flown / "study.json").read_bytes())
    header, first, *_ = (flown / "trials.csv").read_text().splitlines(keepends=True)
    kept = header + first
    (folder / "trials.csv").write_text(kept)

    def small_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(kept) + 100, len(kept) + 100))

    run = gtmr("campaign", *ARGUMENTS, "--out", folder, preexec_fn=small_files)

    assert run.returncode == 1
    assert "cannot be written" in run.stderr
    assert "finished trials are kept" in run.stderr
    assert run.stderr.count("\n") == 1
    assert (folder / "trials.csv").read_text() == kept


def test_a_line_that_does_not_fit_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    row = trial.empty_row(0, "robust") | {"status": "error"}
    with open_campaign("--out", tmp_path / "out", Study(trials=1)) as file:
        before = file.path.read_bytes()
        with monkeypatch.context() as disk:
            disk.setattr(Path, "open", _full)
            with pytest.raises(ResultsError, match="No space left"):
                file.append([row])
        assert file.path.read_bytes() == before


def _full(*_, **__):
    raise OSError(28, "No space left on device")


def test_percentiles_of_many_trials_stand_for_the_pooled_residual():
    """The stated accuracy of the quartiles: half a millimetre for the paper's 500 trials."""
    rng = np.random.default_rng(0)
    mean, spread = rng.normal(-0.15, 0.05, (500, 1)), rng.uniform(0.01, 0.1, (500, 1))
    phase = np.linspace(0.0, 6.0 * np.pi, 2000)
    residuals = mean + spread * np.sin(phase + rng.uniform(0.0, 6.0, (500, 1)))

    kept = np.percentile(residuals, trial.QUANTILES_PERCENT, axis=1)

    levels = (25, 50, 75)
    np.testing.assert_allclose(
        np.percentile(kept, levels), np.percentile(residuals, levels), atol=5e-4
    )
    assert len(QUANTILE_COLUMNS) == len(set(QUANTILE_COLUMNS)) == 20


def test_a_flight_that_diverges_is_an_error_not_a_figure(monkeypatch):
    def diverges(scenario, controller, duration_s, period_s):
        log = fly(scenario, controller, duration_s, period_s)
        return FlightLog(**{**log.__dict__, "d_T": np.full_like(log.d_T, np.nan)})

    monkeypatch.setattr(trial, "fly", diverges)

    assert "not finite" in fly_trial(Study(duration_s=0.1), 0, "robust")["error"]


@pytest.mark.parametrize(
    ("events", "trials", "low", "high"),
    # Newcombe, Statistics in Medicine 17 (1998), table I, method 3.
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_interval_is_that_of_the_literature(events, trials, low, high):
    assert wilson_interval(events, trials) == pytest.approx((low, high), abs=1e-4)


def test_the_ranking_finds_the_channel_that_matters():
    rng = np.random.default_rng(1)
    study = Study(trials=400)
    zeta = np.array([study.scenario(k).zeta for k in range(400)])
    trials = pd.DataFrame(zeta, columns=COLUMNS[5:14]).assign(
        status="flown",
        # Towards or away: it is the size of the wind that counts, not its sign.
        min_clearance_m=0.3
        - 0.1 * np.abs(zeta[:, 6])
        + 0.3 * zeta[:, 0]
        + rng.normal(0, 1e-3, 400),
    )

    shares = channel_shares(trials)

    assert list(shares.index[:2]) == ["w_bx", "mass"]
    assert shares["w_bx"] > 0.5
    assert shares.iloc[2:].max() < 0.05


CHROMIUM = next(
    (Path(p) for p in ("/usr/bin/chromium", "/usr/bin/google-chrome") if Path(p).exists()), None
)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_the_report_in_a_browser_draws_all_and_asks_for_nothing(flown, tmp_path):
    html, *_ = write_campaign_report([flown], tmp_path / "report.html")
    # The page itself counts what it has loaded.
    count = "document.body.dataset.loaded = performance.getEntriesByType('resource').length"
    page = html.read_text().replace("</body>", f"<script>{count}</script></body>")
    html.write_text(page)
    run = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}/p",
         "--no-first-run", "--enable-logging=stderr", "--dump-dom", f"file://{html}"],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip

    for name in FIGURES:
        assert f'<figure id="{name}"><svg' in run.stdout
    assert 'data-loaded="0"' in run.stdout
    assert "CONSOLE" not in run.stderr


def test_a_report_of_a_campaign_that_was_cut_short_says_so(flown, tmp_path):
    part = tmp_path / "part"
    part.mkdir()
    (part / "study.json").write_bytes((flown / "study.json").read_bytes())
    lines = (flown / "trials.csv").read_text().splitlines(keepends=True)
    (part / "trials.csv").write_text("".join(lines[:4]))

    html, *_ = write_campaign_report([part], tmp_path / "report.html")

    assert "9 flights are still missing" in html.read_text()
    assert Campaign.read(part).summary["nominal"]["trials"] == 2


def test_a_report_of_what_is_no_campaign_says_so(tmp_path):
    with pytest.raises(InputError, match="holds no campaign"):
        write_campaign_report([tmp_path], tmp_path / "report.html")
    with pytest.raises(InputError, match="cannot be read"):
        read_trials(tmp_path)
