# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Reproduce the paper: its campaign, Table II, Fig. 1, Fig. 2, and what lies behind them."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gtmr_model import N_ZETA, Helix
from gtmr_model.dynamics import ATTITUDE, POSITION, YAW
from gtmr_monitor.flight import Flight
from gtmr_monitor.report.drawing import save
from gtmr_nmpc import PAPER_MODES, Controller, Mode
from gtmr_sim import FlightLog, GustConfig, fly
from gtmr_study.campaign import cluster
from gtmr_study.campaign.figures import Campaign, write_figures
from gtmr_study.campaign.run import fly_campaign
from gtmr_study.campaign.study import Study
from gtmr_study.paper import figures as paper_figures
from gtmr_study.paper import first_order
from gtmr_study.paper.claims import FIG_1_ZETA, PAPER, TRIALS, deviations, distances
from gtmr_study.paper.claims_table import claims, claims_markdown
from gtmr_study.paper.margin_budget import alpha_by_helix_speed, hoelder_ratio
from gtmr_study.paper.report.page import write_page
from gtmr_study.paper.report.tables import sensitivity_markdown
from gtmr_study.paper.variants import fly_variants, variants
from gtmr_study.result_files import write_json

RESULTS_FILE = "reproduction.json"
REPORT_FILE = "report.html"
CLAIMS_FILE = "claims.md"
SENSITIVITY_FILE = "sensitivity.md"
VARIANTS_FOLDER = "variants"

OnProgress = Callable[[str, int, int], None]
"""Told what is being done, how much of it is done, and of how much."""


@dataclass(frozen=True)
class Effort:
    """How much is flown."""

    trials: int
    """Trials a mode."""
    duration_s: float
    """Length of a flight [s]."""
    quality_duration_s: float
    """Length of the flights whose plans are tried open loop, one a trial [s]."""
    variant_trials: int
    """Trials a mode with one thing changed, for each change; 0 leaves these out."""
    variant_duration_s: float = 20.0
    """Length of these flights: more than a turn around the tower [s]."""


FULL = Effort(trials=TRIALS, duration_s=50.0, quality_duration_s=5.0, variant_trials=24)
"""The paper's own effort."""
QUICK = Effort(trials=24, duration_s=50.0, quality_duration_s=3.0, variant_trials=0)
"""About a minute."""

QUALITY_CHUNK = 5
"""Trials handed out at a time."""


def reproduce(
    base: Study,
    effort: Effort,
    folder: Path,
    n_workers: int | None = None,
    scheduler: str | None = None,
    on_progress: OnProgress | None = None,
    command: str = "gtmr reproduce",
) -> dict[str, Any]:
    """Fly everything and write the results, or go on where it was interrupted.

    The folder, which is also that of the campaign, workers and errors are as for `fly_campaign`;
    ``command`` is what the user called, for the table of claims. Returns the content of
    reproduction.json: ``command``, ``summary``, ``paper``, ``deviations``, ``distance``,
    ``fig_1``, ``calm``, ``first_order``, ``hoelder_ratio``, ``alpha_by_helix_speed`` and
    ``variants``.
    """
    tell = on_progress if on_progress is not None else lambda what, done, total: None
    Helix.required(base.controller.helix)
    study = base.model_copy(
        update={"modes": PAPER_MODES, "trials": effort.trials, "duration_s": effort.duration_s}
    )
    summary = fly_campaign(study, folder, n_workers, scheduler, partial(tell, "trials"))
    logs: dict[str, FlightLog] = {}
    for done, mode in enumerate(PAPER_MODES, start=1):
        logs[mode] = _flight(study, mode, zeta=FIG_1_ZETA, seed=study.seed)
        tell("Fig. 1", done, len(PAPER_MODES))
    flown_variants = []
    with cluster.workers(n_workers, scheduler) as workers:
        if effort.variant_trials:
            made = variants(study, effort.variant_trials, effort.variant_duration_s)
            tell_variants = partial(tell, "one change at a time")
            flown_variants = fly_variants(workers, made, folder / VARIANTS_FOLDER, tell_variants)
        found = list(_perturbations(workers, study, effort, partial(tell, "first order")))
    results: dict[str, Any] = {
        "command": command,
        "seed": study.seed,
        "summary": summary,
        "paper": {mode: row.__dict__ for mode, row in PAPER.items()},
        "deviations": {mode: deviations(summary[mode], mode) for mode in PAPER_MODES},
        "distance": distances(summary),
        "fig_1": {mode: _fig_1_figures(study, log) for mode, log in logs.items()},
        "calm": _calm_flight(study),
        "first_order": first_order.quality(first_order.Perturbations.join(found)),
        "hoelder_ratio": hoelder_ratio(study.controller),
        "alpha_by_helix_speed": alpha_by_helix_speed(study.controller),
        "variants": flown_variants,
    }
    write_json(folder / RESULTS_FILE, results)
    write_figures(folder)
    tower, helix = study.controller.tower, study.controller.helix
    drawn: dict[str, Callable[[], Any]] = {
        "table-ii": partial(paper_figures.table_ii, summary),
        "fig-1": partial(paper_figures.fig_1, logs, tower, helix),
        "fig-2": partial(paper_figures.fig_2, summary),
        "first-order": partial(first_order.draw, results["first_order"]),
    }
    for name, draw in drawn.items():
        save(draw, folder / name)
    found_claims = claims(study, results)
    flights = [_as_flight(study, mode, log) for mode, log in logs.items()]
    write_page(folder / REPORT_FILE, Campaign.read(folder), found_claims, results, flights)
    (folder / CLAIMS_FILE).write_text(claims_markdown({"ours": found_claims}), encoding="utf-8")
    (folder / SENSITIVITY_FILE).write_text(sensitivity_markdown(results), encoding="utf-8")
    return results


def _flight(study: Study, mode: Mode, **world: Any) -> FlightLog:
    """Fly the first trial in a world that is changed."""
    scenario = study.scenario(0).model_copy(update=world)
    controller = Controller(study.controller, mode)
    return fly(scenario, controller, study.duration_s, study.controller.sampling_time_s)


def _as_flight(study: Study, mode: str, log: FlightLog) -> Flight:
    """Make what reports draw of a flight."""
    config = study.controller
    return Flight.from_rows(
        vars(log),
        name=mode,
        mode=mode,
        tower=config.tower,
        helix=config.helix,
        vehicle=config.vehicle,
        gust=study.gust.kind,
        seed=study.seed,
        sampling_time_s=config.sampling_time_s,
    )


def _fig_1_figures(study: Study, log: FlightLog) -> dict[str, float]:
    tower = study.controller.tower
    reference = study.controller.helix.at(log.t, tower)
    position, yaw = log.x[:, POSITION], log.x[:, YAW]
    roll_pitch = log.x[:, ATTITUDE][:, :2]
    inward = np.arctan2(-position[:, 1], -position[:, 0])
    off_tower = np.angle(np.exp(1j * (yaw - inward)))
    distance_m = np.linalg.norm(position - reference.position, axis=1)
    return {
        "min_clearance_m": float(log.d_T.min()),
        "tracking_rms_m": float(np.sqrt(np.mean(distance_m**2))),
        "tilt_deg": float(np.degrees(np.abs(roll_pitch).max())),
        "off_tower_deg": float(np.degrees(np.abs(off_tower).max())),
    }


def _calm_flight(study: Study) -> dict[str, float]:
    """See, without mismatch and gusts, if more clearance is kept where the margin is large."""
    log = _flight(study, "robust", zeta=(0.0,) * N_ZETA, gust=GustConfig(kind="none"))
    # The margin of a plan's end is about where the vehicle will be a horizon later.
    horizon = study.controller.horizon
    alpha_n, clearance = log.alpha_p[:-horizon, -1], log.d_T[horizon:]
    settled = slice(len(clearance) // 2, None)
    alpha_n, clearance = alpha_n[settled], clearance[settled]
    low, high = np.percentile(alpha_n, (25.0, 75.0))
    extra_m = clearance[alpha_n >= high].mean() - clearance[alpha_n <= low].mean()
    return {
        "alpha_p_n_low_m": float(low),
        "alpha_p_n_high_m": float(high),
        "extra_clearance_m": float(extra_m),
    }


def _perturbations(
    workers: Executor, study: Study, effort: Effort, tell: Callable[[int, int], None]
) -> Iterator[first_order.Perturbations]:
    short = study.model_copy(update={"duration_s": effort.quality_duration_s})
    chunks = [
        range(start, min(start + QUALITY_CHUNK, effort.trials))
        for start in range(0, effort.trials, QUALITY_CHUNK)
    ]
    results = {}
    done = cluster.run_chunks(workers, first_order.perturbations, short, chunks)
    for k, (chunk, result) in enumerate(done):
        tell(k + 1, len(chunks))
        if isinstance(result, BaseException):
            raise result
        results[chunk] = result
    # In the order of the trials, so that the same seed gives the same figures to the last digit.
    yield from (results[chunk] for chunk in chunks)
