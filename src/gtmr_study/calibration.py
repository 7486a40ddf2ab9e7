# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""Search what the paper leaves out for the values that come closest to its results."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import optuna
import pandas as pd
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from gtmr_nmpc import MODES, ControllerConfig, Mode
from gtmr_sim import GustConfig
from gtmr_study import cluster
from gtmr_study.paper_claims import deviations, distance
from gtmr_study.study import Study
from gtmr_study.summary import summarise

Target = Literal["nominal", "both"]
TARGETS: tuple[Target, ...] = ("nominal", "both")
"""Which rows of the paper a search aims at."""

JOURNAL = "search.journal"
"""Every evaluation of every search in a folder, as Optuna keeps it."""

OnEvaluation = Callable[[int, float], None]
"""Told the number of evaluations done, and the least distance."""

# Name: lower and upper bound, and whether it is searched on a logarithmic scale.
SPACE: dict[str, tuple[float, float, bool]] = {
    "rotor_acceleration_weight": (1e-5, 1e-2, True),
    "attitude_weight": (1.0, 100.0, True),
    "drag_n_s_per_m": (0.0, 0.5, False),
    "max_rotor_acceleration_hz_s": (20.0, 400.0, True),
    "max_rotor_speed_hz": (80.0, 120.0, False),
    "helix_speed_m_s": (0.2, 1.5, False),
    "helix_climb_m_s": (0.0, 0.2, False),
    "gust_std_n": (0.1, 0.6, False),
    "gust_correlation_time_s": (0.1, 3.0, True),
    "slack_penalty": (1.0, 1e4, True),
    "eps_s_m": (1e-4, 0.15, True),
}
"""What is searched; ``eps_s_m`` only where the robust row counts."""


def candidate(parameters: dict[str, float], base: Study) -> Study:
    """Put searched values into a study.

    Parameters
    ----------
    parameters : dict
        By the names of `SPACE`; what is missing stays as it is. Rate weights are a tenth of the
        attitude weights.
    base : Study
        All else.

    Returns
    -------
    Study
    """
    config, gust = base.controller, base.gust
    p = parameters
    weights: dict[str, float] = {}
    if "rotor_acceleration_weight" in p:
        weights["rotor_acceleration"] = p["rotor_acceleration_weight"]
    if "attitude_weight" in p:
        attitude = p["attitude_weight"]
        weights |= {"roll_pitch": attitude, "yaw": attitude, "rate": attitude / 10.0}
    vehicle = _named(p, "drag_n_s_per_m", "max_rotor_acceleration_hz_s", "max_rotor_speed_hz")
    helix = _named(p, speed_m_s="helix_speed_m_s", climb_m_s="helix_climb_m_s")
    gusts = _named(p, std_n="gust_std_n", correlation_time_s="gust_correlation_time_s")
    controller = config.model_dump() | {
        "weights": config.weights.model_dump() | weights,
        "vehicle": config.vehicle.model_dump() | vehicle,
        "helix": config.helix.model_dump() | helix,
        **_named(p, "eps_s_m", slack_l1="slack_penalty", slack_l2="slack_penalty"),
    }
    return base.model_copy(
        update={
            "controller": ControllerConfig.parse(controller, "candidate"),
            "gust": GustConfig.parse(gust.model_dump() | gusts, "candidate"),
        }
    )


def defaults(base: Study) -> dict[str, float]:
    """Read the searched values off a study: where a search begins.

    Parameters
    ----------
    base : Study
        The study.

    Returns
    -------
    dict
        By the names of `SPACE`.
    """
    config = base.controller
    return {
        "rotor_acceleration_weight": config.weights.rotor_acceleration,
        "attitude_weight": config.weights.roll_pitch,
        "drag_n_s_per_m": config.vehicle.drag_n_s_per_m,
        "max_rotor_acceleration_hz_s": config.vehicle.max_rotor_acceleration_hz_s,
        "max_rotor_speed_hz": config.vehicle.max_rotor_speed_hz,
        "helix_speed_m_s": config.helix.speed_m_s,
        "helix_climb_m_s": config.helix.climb_m_s,
        "gust_std_n": base.gust.std_n,
        "gust_correlation_time_s": base.gust.correlation_time_s,
        "slack_penalty": config.slack_l1,
        "eps_s_m": config.eps_s_m,
    }


def calibrate(
    base: Study,
    target: Target,
    evaluations: int,
    folder: Path,
    n_workers: int | None = None,
    on_evaluation: OnEvaluation | None = None,
) -> dict[str, Any]:
    """Search with Optuna's tree-structured Parzen estimator, or go on with a search.

    Parameters
    ----------
    base : Study
        Trials, duration, seed, and where the search begins. Every evaluation flies the same
        trials.
    target : str
        ``nominal``: the nominal rows of Table II and Fig. 2; ``both``: the robust rows as well.
    evaluations : int
        How many there shall be in all.
    folder : pathlib.Path
        Keeps the search; one that is there already is gone on with.
    n_workers : int, optional
        Processes; one per processor if left out.
    on_evaluation : callable, optional
        Called after each.

    Returns
    -------
    dict
        ``target``, ``evaluations``, and of the best one ``distance``, ``parameters``,
        ``deviations`` and ``summary``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    modes: tuple[Mode, ...] = MODES if target == "both" else ("nominal",)
    base = base.model_copy(update={"modes": modes})
    names = [name for name in SPACE if name != "eps_s_m" or "robust" in modes]
    search = optuna.create_study(
        study_name=f"{target}, seed {base.seed}, {base.n_trials} trials of {base.duration_s:g} s",
        storage=JournalStorage(JournalFileBackend(str(folder / JOURNAL))),
        load_if_exists=True,
    )
    if not search.trials:
        search.enqueue_trial({name: defaults(base)[name] for name in names})
    with cluster.local_workers(n_workers) as client:

        def evaluate(trial: optuna.Trial) -> float:
            parameters = {
                name: trial.suggest_float(name, *SPACE[name][:2], log=SPACE[name][2])
                for name in names
            }
            study = candidate(parameters, base)
            rows = [r for rows in cluster.fly_on(client, study, study.flights()) for r in rows]
            summary = summarise(pd.DataFrame(rows))
            trial.set_user_attr("summary", summary)
            return distance(summary, modes)

        for number in range(_done(search), evaluations):
            # Seeded by the number, a search that was interrupted goes on as if it had not been.
            seed = int(np.random.SeedSequence([base.seed, number]).generate_state(1)[0])
            search.sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True)
            search.optimize(evaluate, n_trials=1)
            if on_evaluation is not None:
                on_evaluation(number + 1, search.best_value)
    summary = search.best_trial.user_attrs["summary"]
    return {
        "target": target,
        "evaluations": _done(search),
        "distance": search.best_value,
        "parameters": search.best_params,
        "deviations": {mode: deviations(summary[mode], mode) for mode in modes},
        "summary": summary,
    }


def _done(search: optuna.Study) -> int:
    return len(search.get_trials(states=(optuna.trial.TrialState.COMPLETE,)))


def _named(parameters: dict[str, float], *same: str, **renamed: str) -> dict[str, float]:
    """Pick parameters that are given, under the names of the fields they belong to."""
    fields = {name: name for name in same} | renamed
    return {field: parameters[name] for field, name in fields.items() if name in parameters}
