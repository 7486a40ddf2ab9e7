# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A campaign ends with the same results however it is cut up, killed, or where it runs."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from support.campaign_runs import ARGUMENTS, FIELDS, STUDY, TIMES, WORKERS, rows_of, without_times
from support.command_line import command, gtmr_process

from gtmr_study.campaign import cluster, trial
from gtmr_study.campaign.run import fly_campaign
from gtmr_study.campaign.study import Study
from gtmr_study.campaign.trial import fly_trial
from gtmr_study.campaign.trials_file import open_campaign
from gtmr_study.results_folder import ResultsError

DEADLINE_S = 120.0


def wait_for(condition):
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def text_without_times(folder):
    """Lines of trials.csv as they are, but for the measured times, which end every line."""
    lines = (folder / "trials.csv").read_text().splitlines()
    assert lines[0].endswith("," + ",".join(TIMES))
    return [line.rsplit(",", len(TIMES))[0] for line in lines]


@pytest.mark.slow
def test_four_threads_two_processes_and_one_thread_give_the_same_file(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "LARGEST_CHUNK", 1)
    two_processes, in_threads = tmp_path / "processes", (1, 4)
    for n in in_threads:
        fly_campaign(STUDY, tmp_path / str(n), n_workers=n)
    monkeypatch.setattr(cluster, "local_threads", cluster.local_workers)
    fly_campaign(Study(**FIELDS, modes=("robust", "nominal")), two_processes, n_workers=2)

    for n in in_threads:
        assert text_without_times(tmp_path / str(n)) == text_without_times(two_processes)


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


@pytest.mark.slow
def test_killed_at_any_moment_it_goes_on_and_loses_no_finished_trial(flown, tmp_path):
    folder = tmp_path / "out"
    killed = subprocess.Popen(
        command("campaign", *ARGUMENTS, *WORKERS, "--out", folder),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    wait_for((folder / "trials.csv").exists)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    kept = (folder / "trials.csv").read_text()
    # As if it had been killed in the middle of a line.
    done = (flown / "trials.csv").read_text().splitlines(keepends=True)
    lines = [*(kept.splitlines(keepends=True) or done[:1]), done[5], done[8][:40]]
    (folder / "trials.csv").write_text("".join(lines))
    finished = (folder / "trials.csv").read_text().count("\n")

    fly_campaign(STUDY, folder, n_workers=2)

    assert finished >= 2
    assert done[5] in (folder / "trials.csv").read_text()
    pd.testing.assert_frame_equal(rows_of(folder), rows_of(flown))
    ended = json.loads((folder / "summary.json").read_text())
    assert without_times(ended) == without_times(json.loads((flown / "summary.json").read_text()))


@pytest.mark.slow
def test_interrupted_by_the_whole_terminal_it_says_so_in_one_line(tmp_path):
    trials = tmp_path / "out" / "trials.csv"
    interrupted = subprocess.Popen(
        command(
            "campaign", "--trials", "500", "--duration", "2", *WORKERS, "--out", trials.parent
        ),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # Where the tests run in the background, a shell has them ignore it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    wait_for(lambda: trials.exists() and trials.read_text().count("\n") > 1)
    # As a terminal does: to the workers as well.
    os.killpg(interrupted.pid, signal.SIGINT)
    _, said = interrupted.communicate(timeout=DEADLINE_S)

    assert interrupted.returncode == 130
    assert said == "gtmr: interrupted\n"


def test_a_finished_campaign_started_again_flies_nothing(flown, monkeypatch):
    before = (flown / "trials.csv").read_bytes()
    monkeypatch.setattr(cluster, "local_threads", None)

    fly_campaign(STUDY, flown)

    assert (flown / "trials.csv").read_bytes() == before


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
        worker = [*start, "worker", *at, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        processes.append(subprocess.Popen(worker, cwd=tmp_path, **quiet))
    yield json.loads(file.read_text())["address"], processes
    # Asked to end, a worker may wait for a scheduler that has gone already.
    for process in processes:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_a_running_scheduler_gives_the_same_rows_even_if_a_worker_is_killed(
    flown, scheduler, tmp_path
):
    address, processes = scheduler
    arguments = [*ARGUMENTS, "--scheduler", address, "--out", tmp_path / "out"]
    run = subprocess.Popen(
        command("campaign", *arguments), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    wait_for((tmp_path / "out" / "trials.csv").exists)

    processes[-1].kill()

    _, problems = run.communicate(timeout=120)
    assert run.returncode == 0, problems.decode()
    pd.testing.assert_frame_equal(rows_of(tmp_path / "out"), rows_of(flown))


@pytest.mark.slow
def test_a_full_disk_is_said_and_finished_trials_are_kept(flown, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "study.json").write_bytes((flown / "study.json").read_bytes())
    header, first, *_ = (flown / "trials.csv").read_text().splitlines(keepends=True)
    kept = header + first
    (folder / "trials.csv").write_text(kept)

    def small_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(kept) + 100, len(kept) + 100))

    # A compiled module that is cut off would break every later start of Python.
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    run = gtmr_process(
        "campaign", *ARGUMENTS, "--workers", 1, "--out", folder,
        preexec_fn=small_files, env=environment,
    )  # fmt: skip

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
