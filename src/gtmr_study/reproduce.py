# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""Reproduce the paper: its campaign, Table II, Fig. 1, Fig. 2, and what lies behind them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd

from gtmr_model import CHANNELS
from gtmr_monitor import look
from gtmr_nmpc import MODES, Controller
from gtmr_sim import FlightLog, fly
from gtmr_study import cluster, first_order, paper_figures
from gtmr_study.campaign import fly_campaign
from gtmr_study.campaign_figures import Campaign, write_figures
from gtmr_study.campaign_report import campaign_section, page, table
from gtmr_study.drawing import inline_svg, save
from gtmr_study.margin_budget import margin_budget, unit_slips
from gtmr_study.paper_claims import PAPER, TRIALS, WIND_BIAS_N, claims, deviations, distance
from gtmr_study.result_files import write_json
from gtmr_study.study import Study
from gtmr_study.summary import summarise

RESULTS_FILE = "reproduction.json"
REPORT_FILE = "report.html"
CLAIMS_FILE = "claims.md"

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
    """Robust trials with each of the other margins; 0 leaves these out."""
    variant_duration_s: float = 20.0
    """Length of these flights [s]."""


FULL = Effort(trials=TRIALS, duration_s=50.0, quality_duration_s=5.0, variant_trials=24)
"""The paper's own effort."""
QUICK = Effort(trials=24, duration_s=50.0, quality_duration_s=3.0, variant_trials=0)
"""About a minute."""

EPS_S_TRIED_M = (0.03, 0.06, 0.09, 0.12, 0.15)
"""Constant terms of the margin that are tried [m]."""
QUALITY_CHUNK = 5
"""Trials handed out at a time."""


def reproduce(
    base: Study,
    effort: Effort,
    folder: Path,
    n_workers: int | None = None,
    scheduler: str | None = None,
    on_progress: OnProgress | None = None,
) -> dict[str, Any]:
    """Fly everything and write the results, or go on where it was interrupted.

    Parameters
    ----------
    base : Study
        Controller, uncertainty, gusts and seed.
    effort : Effort
        How much is flown.
    folder : pathlib.Path
        New, empty, or of the same reproduction; it is also the folder of the campaign.
    n_workers : int, optional
        Processes on this machine; one per processor if left out.
    scheduler : str, optional
        Address of a running Dask scheduler, instead.
    on_progress : callable, optional
        Called while flying.

    Returns
    -------
    dict
        Content of reproduction.json: ``summary``, ``paper``, ``deviations``, ``distance``,
        ``fig_1``, ``first_order`` and ``variants``.

    Raises
    ------
    InputError
        If the folder holds anything else, or the scheduler is not there.
    ResultsError
        If results cannot be written; finished trials are kept.
    """
    tell = on_progress if on_progress is not None else lambda what, done, total: None
    study = base.model_copy(
        update={"modes": MODES, "trials": effort.trials, "duration_s": effort.duration_s}
    )
    summary = fly_campaign(study, folder, n_workers, scheduler, partial(tell, "trials"))
    logs = _fig_1_flights(study, partial(tell, "Fig. 1"))
    with cluster.workers(n_workers, scheduler) as client:
        found = list(_perturbations(client, study, effort, partial(tell, "first order")))
        variants = []
        if effort.variant_trials:
            variants = _fly_variants(client, study, effort, partial(tell, "other margins"))
    results = {
        "seed": study.seed,
        "summary": summary,
        "paper": {mode: row.__dict__ for mode, row in PAPER.items()},
        "deviations": {mode: deviations(summary[mode], mode) for mode in MODES},
        "distance": {"nominal": distance(summary, ("nominal",)), "both": distance(summary, MODES)},
        "fig_1": {mode: {"min_clearance_m": float(log.d_T.min())} for mode, log in logs.items()},
        "first_order": first_order.quality(first_order.Perturbations.join(found)),
        "variants": variants,
    }
    write_json(folder / RESULTS_FILE, results)
    write_figures(folder)
    drawn = _figures(study, results, logs)
    for name, draw in drawn.items():
        save(draw, folder / name)
    html = _page(Campaign.read(folder), results, drawn)
    (folder / REPORT_FILE).write_text(html, encoding="utf-8")
    (folder / CLAIMS_FILE).write_text(_markdown(claims(summary)), encoding="utf-8")
    return results


def _markdown(rows: list[tuple[str, str, str, str]]) -> str:
    lines = [("claim", "paper", "here", "verdict"), ("---",) * 4, *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _fig_1_flights(study: Study, tell: Callable[[int, int], None]) -> dict[str, FlightLog]:
    scenario = study.scenario(0).model_copy(
        update={"zeta": (*(0.0,) * 6, *WIND_BIAS_N), "seed": study.seed}
    )
    logs: dict[str, FlightLog] = {}
    for k, mode in enumerate(MODES):
        controller = Controller(study.controller, mode)
        period = study.controller.sampling_time_s
        logs[mode] = fly(scenario, controller, study.duration_s, period)
        tell(k + 1, len(MODES))
    return logs


def _perturbations(
    client: cluster.Client, study: Study, effort: Effort, tell: Callable[[int, int], None]
) -> Iterator[first_order.Perturbations]:
    short = study.model_copy(update={"duration_s": effort.quality_duration_s})
    chunks = [
        range(start, min(start + QUALITY_CHUNK, effort.trials))
        for start in range(0, effort.trials, QUALITY_CHUNK)
    ]
    done = cluster.run_chunks(client, first_order.perturbations, short, chunks)
    results = {}
    for k, (chunk, result) in enumerate(done):
        tell(k + 1, len(chunks))
        if isinstance(result, BaseException):
            raise result
        results[chunk] = result
    # In the order of the trials, so that the same seed gives the same figures to the last digit.
    yield from (results[chunk] for chunk in chunks)


def _fly_variants(
    client: cluster.Client, study: Study, effort: Effort, tell: Callable[[int, int], None]
) -> list[dict[str, Any]]:
    """Fly the robust controller with other margins in the same world."""
    config = study.controller
    variants = unit_slips(config) | {
        f"ε_s = {eps_s_m:g} m": config.model_copy(update={"eps_s_m": eps_s_m})
        for eps_s_m in EPS_S_TRIED_M
    }
    rows = []
    for k, (name, controller) in enumerate(variants.items()):
        changes = {
            "controller": controller,
            "uncertainty": study.true_uncertainty,
            "modes": ("robust",),
            "trials": effort.variant_trials,
            "duration_s": effort.variant_duration_s,
        }
        varied = study.model_copy(update=changes)
        parts = list(cluster.fly_on(client, varied, varied.flights()))
        flown = pd.DataFrame([row for part in parts for row in part]).sort_values("trial")
        rows.append(
            {
                "name": name,
                "margins_m": margin_budget(controller),
                "summary": summarise(flown)["robust"],
            }
        )
        tell(k + 1, len(variants))
    return rows


def _figures(
    study: Study, results: dict[str, Any], logs: dict[str, FlightLog]
) -> dict[str, Callable[[], Any]]:
    config, summary = study.controller, results["summary"]
    return {
        "table-ii": partial(paper_figures.table_ii, summary),
        "fig-1": partial(paper_figures.fig_1, logs, config.tower, config.helix),
        "fig-2": partial(paper_figures.fig_2, summary),
        "first-order": partial(first_order.draw, results["first_order"]),
    }


_CAPTIONS = {
    "table-ii": "The paper's solve times are those of MATLAB on another machine.",
    "fig-1": "Under a wind bias of [0.6, 0.4, 0.0] N. The paper gives this figure as a drawing, "
    "without numbers to compare with.",
    "fig-2": "The paper's boxes (grey) are drawn from the coordinates of its figure.",
    "first-order": "Plans of the robust controller flown open loop: the change of the clearance "
    "over the margin that should bound it. Above the dashed line the margin is exceeded.",
}


def _page(campaign: Campaign, results: dict[str, Any], drawn: dict[str, Callable[[], Any]]) -> str:
    figures = "\n".join(
        f'<figure id="{name}">{inline_svg(draw)}</figure>\n<p>{_CAPTIONS[name]}</p>'
        for name, draw in drawn.items()
    )
    rows = [(claim, cells) for claim, *cells in claims(results["summary"])]
    return page(
        "Reproduction of the paper",
        f"""{table(["paper", "here", "verdict"], rows)}
{figures}
{_variants(results["variants"])}
{campaign_section(campaign)}""",
    )


def _variants(variants: list[dict[str, Any]]) -> str:
    if not variants:
        return ""
    parts = [*CHANNELS, "eps_s", "gust", "total"]
    labels = [{**look.MARGIN_LABELS, "total": "total"}[part] for part in parts]
    flown, keys = ["least [m]", "median [m]"], ("min_clearance_m", "median_clearance_m")
    rows = [
        (
            escape(variant["name"]),
            [f"{1e3 * variant['margins_m'][part]:.1f}" for part in parts]
            + [f"{variant['summary'][key]:.3f}" for key in keys],
        )
        for variant in variants
    ]
    return f"""<h2>Size of the tightening</h2>
<p>Parts of the margin at the last stage [mm], averaged over a turn round the tower: as the
paper's formulas and bounds give it, as slips of units would, and with larger constant terms; and
the clearance of robust flights with it. The paper's robust row asks for a least clearance of
{PAPER["robust"].min_clearance_m:g} m and a median of 0.39 m.</p>
{table([*labels, *flown], rows)}"""
