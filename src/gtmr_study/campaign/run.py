# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A Monte-Carlo campaign from start, or from where it was interrupted, to its summary."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from gtmr_study.campaign import cluster
from gtmr_study.campaign.study import Study
from gtmr_study.campaign.summary import summarise
from gtmr_study.campaign.trials_file import (
    in_order,
    open_campaign,
    read_trials,
    require_own_or_empty,
)
from gtmr_study.own_controller import OwnController
from gtmr_study.result_files import InputError, write_json
from gtmr_study.results_folder import writing

SUMMARY_FILE = "summary.json"

OnProgress = Callable[[int, int], None]
"""Told how many flights are done, and of how many."""


def fly_campaign(
    study: Study,
    folder: Path,
    n_workers: int | None = None,
    scheduler: str | None = None,
    on_progress: OnProgress | None = None,
    own: OwnController | None = None,
) -> dict[str, dict[str, Any]]:
    """Fly what is missing of a campaign, and sum it up as `summarise` does.

    The folder is new, empty, or holds a part of the same study; it receives study.json, trials.csv
    as trials are done, and at the end summary.json. An own controller flies instead of the
    suite's, in processes instead of threads. Workers and errors are those of `cluster.workers`;
    InputError as well if the folder
    holds anything else or an own controller cannot be made, ResultsError if results cannot be
    written; finished trials are kept.
    """
    if own is not None:
        own.make(study.controller)
        study = study.model_copy(update={"own_controller": own.fingerprint})
    elif study.own_controller is not None:
        raise InputError(
            f"own_controller = {study.own_controller.name}: a study can tell of it but not bring "
            "it; name its file: --controller file.py:Class"
        )
    with ExitStack() as stack:
        require_own_or_empty("--out", folder, study)
        workers = None
        if scheduler is not None:
            # Before anything is written: a wrong address leaves no folder behind.
            workers = stack.enter_context(cluster.remote_workers(scheduler))
        file = stack.enter_context(open_campaign("--out", folder, study))
        flights = study.flights()
        missing = [flight for flight in flights if flight not in file.done]
        if missing and workers is None:
            local = cluster.local_threads if own is None else cluster.local_workers
            workers = stack.enter_context(local(n_workers))
        if on_progress is not None:
            on_progress(len(file.done), len(flights))
        if workers is not None:
            for rows in cluster.fly_on(workers, study, missing, own):
                file.append(rows)
                if on_progress is not None:
                    on_progress(len(file.done), len(flights))
        file.sort(in_order)
        summary = summarise(read_trials(folder))
        with writing(folder / SUMMARY_FILE):
            write_json(folder / SUMMARY_FILE, summary)
    return summary
