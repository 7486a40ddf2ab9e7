# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Search what the paper leaves out for the values that come closest to its results."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import optuna
import pandas as pd
import yaml
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from gtmr_nmpc import PAPER_MODES, Mode
from gtmr_study.campaign import cluster
from gtmr_study.campaign.study import Study, trial_seed
from gtmr_study.campaign.summary import summarise
from gtmr_study.paper.claims import TRIALS, deviations, distance
from gtmr_study.paper.unreported import UNREPORTED, values_of, with_values
from gtmr_study.result_files import InputError, write_whole

Target = Literal["nominal", "both"]
TARGETS: tuple[Target, ...] = ("nominal", "both")
"""Which rows of the paper a search aims at."""
PRESETS = ("paper", "paper-closest")
"""Scenarios that a search begins with, so that it ends no farther from the paper than them."""
SETS: dict[Target, int] = {"nominal": 120, "both": 60}
"""How many sets of values are tried if nobody says: some twelve minutes on two cores."""

JOURNAL = "search.journal"
"""Every set that was tried, as Optuna keeps it."""
BEST = "best.yaml"
"""The best set so far, as a scenario."""

OnProgress = Callable[[int, int], None]
"""Told how many sets were tried, and of how many."""


def calibrate(
    base: Study,
    target: Target,
    sets: int,
    folder: Path,
    n_workers: int | None = None,
    on_progress: OnProgress | None = None,
) -> dict[str, Any]:
    """Search with Optuna's tree-structured Parzen estimator, or go on with a search.

    Every set of values flies the trials of ``base``; there are ``sets`` of them in all, first
    those of `PRESETS`. ``target`` says which rows count: ``nominal``, or ``both``. ``folder``
    keeps the search and, as a scenario, its best set; InputError if it holds anything else.
    Returns ``target``, ``sets``, ``presets`` (their distances by name), and of the best set
    ``distance``, ``parameters``, ``deviations`` and ``summary``.
    """
    modes: tuple[Mode, ...] = PAPER_MODES if target == "both" else ("nominal",)
    base = base.model_copy(update={"modes": modes})
    # eps_s moves the robust rows alone.
    space = {
        name: known
        for name, known in UNREPORTED.items()
        if known.searched is not None and (name != "eps_s_m" or "robust" in modes)
    }
    presets = [values_of(Study.load("scenario", preset)) for preset in PRESETS]
    starts = [{name: values[name] for name in space} for values in presets]
    search = _open(folder, f"{target}, seed {base.seed}, {_flown(base)}")
    done = len(_done(search))
    if done < sets:
        with cluster.local_threads(n_workers) as workers:

            def evaluate(trial: optuna.Trial) -> float:
                values = {
                    name: trial.suggest_float(
                        name, *bounds, step=known.step, log=known.logarithmic
                    )
                    for name, known in space.items()
                    if (bounds := known.searched) is not None
                }
                study = with_values(values, base)
                rows = [
                    r for part in cluster.fly_on(workers, study, study.flights()) for r in part
                ]
                summary = summarise(pd.DataFrame(rows))
                trial.set_user_attr("summary", summary)
                if any(s["errors"] for s in summary.values()):
                    return math.inf
                return distance(summary, modes)

            for number in range(done, sets):
                # A killed search may have left its next start waiting.
                if number < len(starts) and not search.get_trials(states=(TrialState.WAITING,)):
                    search.enqueue_trial(starts[number])
                # Seeded by the number, a search that was cut short goes on as if it had not been.
                seed = trial_seed(base.seed, number)
                search.sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True)
                search.optimize(evaluate, n_trials=1)
                _write_best(folder / BEST, base, target, search)
                if on_progress is not None:
                    on_progress(number + 1, sets)
    # Once more, should the search have been killed just before.
    _write_best(folder / BEST, base, target, search)
    tried = _done(search)
    summary = search.best_trial.user_attrs["summary"]
    return {
        "target": target,
        "sets": len(tried),
        "presets": {name: trial.value for name, trial in zip(PRESETS, tried, strict=False)},
        "distance": search.best_value,
        "parameters": search.best_params,
        "deviations": {mode: deviations(summary[mode], mode) for mode in modes},
        "summary": summary,
    }


def _open(folder: Path, name: str) -> optuna.Study:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--out = {folder}: is a file, expected a folder")
    journal = folder / JOURNAL
    if folder.is_dir() and not journal.exists() and any(folder.iterdir()):
        raise InputError(
            f"--out = {folder}: holds {next(folder.iterdir()).name} but no search; nothing was "
            "changed: give a new or empty folder"
        )
    folder.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    storage = JournalStorage(JournalFileBackend(str(journal)))
    others = [study for study in optuna.get_all_study_names(storage) if study != name]
    if others:
        raise InputError(
            f"--out = {folder}: holds another search, {others[0]!r} where this one is {name!r}; "
            "nothing was changed: give another folder"
        )
    return optuna.create_study(study_name=name, storage=storage, load_if_exists=True)


def _done(search: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    return search.get_trials(states=(TrialState.COMPLETE,))


def _flown(base: Study) -> str:
    return f"{base.n_trials} trials of {base.duration_s:g} s"


def _write_best(path: Path, base: Study, target: Target, search: optuna.Study) -> None:
    """Write the best set as the scenario of a whole campaign."""
    whole = {"modes": PAPER_MODES, "trials": TRIALS}
    best = with_values(search.best_params, base).model_copy(update=whole)
    rows = "the nominal rows" if target == "nominal" else "both modes' rows"
    said = (
        f"# Found by gtmr calibrate --target {target}: the best of {len(_done(search))} sets, at "
        f"distance {search.best_value:.2f}\n"
        f"# from {rows} of the paper, in {_flown(base)}, seed {base.seed}.\n"
    )
    content = yaml.safe_dump(best.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
    write_whole(path, said + content)
