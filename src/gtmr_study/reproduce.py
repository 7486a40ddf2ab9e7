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
from gtmr_study.campaign_report import campaign_section, page, signed, table
from gtmr_study.drawing import inline_svg, save
from gtmr_study.margin_budget import budget_table
from gtmr_study.paper_claims import PAPER, TRIALS, WIND_BIAS_N, deviations, distance
from gtmr_study.result_files import write_json
from gtmr_study.study import Study
from gtmr_study.summary import summarise

RESULTS_FILE = "reproduction.json"
REPORT_FILE = "report.html"

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
    sweep_trials: int
    """Trials at every value of eps_s; 0 leaves the sweep out."""
    sweep_duration_s: float = 20.0
    """Length of these flights [s]."""


FULL = Effort(trials=TRIALS, duration_s=50.0, quality_duration_s=5.0, sweep_trials=24)
"""The paper's own effort."""
QUICK = Effort(trials=24, duration_s=50.0, quality_duration_s=3.0, sweep_trials=0)
"""About a minute."""

EPS_S_SWEPT_M = (0.001, 0.03, 0.06, 0.09, 0.12, 0.15)
"""Values of eps_s that the sweep tries [m]."""
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
        ``fig_1``, ``first_order``, ``margins_m`` and ``eps_s_sweep``.

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
        sweep = _sweep_eps_s(client, study, effort, partial(tell, "sweep of eps_s"))
    results = {
        "seed": study.seed,
        "summary": summary,
        "paper": {mode: row.__dict__ for mode, row in PAPER.items()},
        "deviations": {mode: deviations(summary[mode], mode) for mode in MODES},
        "distance": {"nominal": distance(summary, ("nominal",)), "both": distance(summary, MODES)},
        "fig_1": {mode: {"min_clearance_m": float(log.d_T.min())} for mode, log in logs.items()},
        "first_order": first_order.quality(first_order.Perturbations.join(found)),
        "margins_m": budget_table(study.controller),
        "eps_s_sweep": sweep,
    }
    write_json(folder / RESULTS_FILE, results)
    write_figures(folder)
    drawn = _figures(study, results, logs)
    for name, draw in drawn.items():
        save(draw, folder / name)
    html = _page(Campaign.read(folder), results, drawn)
    (folder / REPORT_FILE).write_text(html, encoding="utf-8")
    return results


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


def _sweep_eps_s(
    client: cluster.Client, study: Study, effort: Effort, tell: Callable[[int, int], None]
) -> list[dict[str, float]]:
    rows = []
    for k, eps_s_m in enumerate(EPS_S_SWEPT_M if effort.sweep_trials else ()):
        controller = study.controller.model_copy(update={"eps_s_m": eps_s_m})
        swept = study.model_copy(
            update={
                "controller": controller,
                "modes": ("robust",),
                "trials": effort.sweep_trials,
                "duration_s": effort.sweep_duration_s,
            }
        )
        flown = [r for part in cluster.fly_on(client, swept, swept.flights()) for r in part]
        summary = summarise(pd.DataFrame(flown).sort_values("trial"))["robust"]
        rows.append(
            {
                "eps_s_m": eps_s_m,
                "min_clearance_m": summary["min_clearance_m"],
                "median_clearance_m": summary["median_clearance_m"],
            }
        )
        tell(k + 1, len(EPS_S_SWEPT_M))
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
    budgets = results["margins_m"]
    parts = [*CHANNELS, "eps_s", "gust", "total"]
    rows = [
        (escape(name), [f"{1e3 * budget[part]:.1f}" for part in parts])
        for name, budget in budgets.items()
    ]
    labels = [{**look.MARGIN_LABELS, "total": "total"}[part] for part in parts]
    sweep = [
        (
            f"{row['eps_s_m']:g}",
            [signed(row["min_clearance_m"]), signed(row["median_clearance_m"])],
        )
        for row in results["eps_s_sweep"]
    ]
    swept = (
        "<h2>What ε<sub>s</sub> would have to be</h2>\n"
        "<p>Robust flights with a larger constant term [m]; the paper's robust row asks for a "
        f"least clearance of {PAPER['robust'].min_clearance_m:g} m and a median of 0.39 m.</p>\n"
        + table(["least clearance", "median clearance"], sweep)
        if sweep
        else ""
    )
    return page(
        "Reproduction of the paper",
        f"""{figures}
<h2>Size of the tightening</h2>
<p>Parts of the margin at the last stage [mm], averaged over a turn round the tower: as the
paper's formulas and bounds give it, and as slips of units would.</p>
{table(labels, rows)}
{swept}
{campaign_section(campaign)}""",
    )
