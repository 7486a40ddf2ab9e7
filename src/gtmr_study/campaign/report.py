# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The report of campaigns: one HTML page that needs nothing else."""

from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from gtmr_monitor.report.drawing import inline_svg, save
from gtmr_monitor.report.html import page, signed, table
from gtmr_study.campaign.figures import Campaign, figures_of, mode_colour, why_no_channels

CAPTIONS = {
    "residual": "s = d<sub>min</sub> − d<sub>T</sub>, pooled over all instants of all trials; "
    "below the dashed line the clearance constraint holds. Boxes show quartiles, whiskers the "
    "extremes.",
    "least-clearance": "Each trial counts with the least clearance of its flight.",
    "violations": "A trial counts if any instant violates the clearance constraint.",
    "channels": "How much of the variance of the least clearance is explained by one channel of "
    "the true mismatch alone, with 95 % intervals. What is missing to 100 % is the interplay of "
    "channels, and gusts.",
    "solve-times": "Preparation and feedback together, wall time, with as many flights at once "
    "as there were workers.",
}
"""Explanation of every figure."""

Value = Callable[[dict[str, Any]], str]


def write_campaign_report(folders: Sequence[Path], out_html: Path) -> list[Path]:
    """Write a report on campaigns, one below the other; give its file, then its figures' files."""
    campaigns = [Campaign.read(folder) for folder in folders]
    names = ", ".join(campaign.name for campaign in campaigns)
    body = "\n".join(campaign_section(campaign) for campaign in campaigns)
    out_html.write_text(page(f"Campaign {names}", body), encoding="utf-8")
    paths = [out_html]
    for number, campaign in enumerate(campaigns, start=1):
        # One campaign's figures need no number.
        prefix = out_html.stem if len(campaigns) == 1 else f"{out_html.stem}-{number}"
        for name, draw in figures_of(campaign).items():
            paths += save(draw, out_html.with_name(f"{prefix}-{name}"), ("png",))
    return paths


def campaign_section(campaign: Campaign) -> str:
    """Describe a campaign in HTML: conditions, figures in numbers, figures drawn."""
    summary = campaign.summary
    missing = campaign.study.n_trials * len(campaign.study.flown_modes) - len(campaign.trials)
    errors = sum(s["errors"] for s in summary.values())
    notes = []
    if missing:
        notes.append(f"{missing} flights are still missing.")
    if errors:
        reason = campaign.trials["error"].dropna().iloc[0]
        notes.append(f"{errors} trials raised; the first: {reason}")
    warnings = "".join(f'<p class="warning">{escape(note)}</p>' for note in notes)
    flown = {mode: s for mode, s in summary.items() if s["trials"]}
    if not flown:
        return f"<h2>{escape(campaign.name)}</h2>{warnings}<p>No trial has flown yet.</p>"
    figures = figures_html(figures_of(campaign), CAPTIONS)
    heads = [(mode, mode_colour(mode)) for mode in flown]
    return f"""<h2>{escape(campaign.name)}</h2>
{warnings}
<div class="tables">
<section><h2>Summary</h2>
{table(heads, [(name, [cell(s) for s in flown.values()]) for name, cell in _ROWS])}</section>
<section><h2>Conditions</h2>
{table([], _conditions(campaign))}</section>
</div>
{figures}
<p>{why_no_channels(campaign)}</p>"""


def figures_html(drawn: dict[str, Callable[[], Figure]], captions: dict[str, str]) -> str:
    """Put figures into a page, each with its explanation below, both by the figure's name."""
    return "\n".join(
        f'<figure id="{name}">{inline_svg(draw)}</figure>\n<p>{captions[name]}</p>'
        for name, draw in drawn.items()
    )


def _residual(key: str) -> Value:
    return lambda s: signed(s["residual_m"][key])


def _solve(key: str) -> Value:
    return lambda s: f"{s['solve_ms'][key]:.2f}"


def _airframe(summary: dict[str, Any]) -> str:
    least_m = summary.get("min_airframe_clearance_m")
    return "not recorded" if least_m is None else signed(least_m)


_ROWS: tuple[tuple[str, Value], ...] = (
    ("trials with a violation", lambda s: f"<strong>{s['violations']}</strong> of {s['trials']}"),
    (
        "95 % interval of their rate",
        lambda s: " to ".join(f"{100 * bound:.1f}" for bound in s["violation_rate_95"]) + " %",
    ),
    ("least clearance [m]", lambda s: f"<strong>{s['min_clearance_m']:.3f}</strong>"),
    ("least clearance of the airframe [m]", _airframe),
    ("median clearance [m]", lambda s: f"{s['median_clearance_m']:.3f}"),
    ("residual s, maximum [m]", _residual("max")),
    ("upper quartile [m]", _residual("q3")),
    ("median [m]", _residual("median")),
    ("lower quartile [m]", _residual("q1")),
    ("minimum [m]", _residual("min")),
    ("d<sub>T</sub> − d<sub>ref</sub>, RMS [m]", lambda s: f"{s['radial_rms_m']:.3f}"),
    ("solve time, mean [ms]", _solve("mean")),
    ("median [ms]", _solve("median")),
    ("99th percentile [ms]", _solve("p99")),
    (
        "steps without a solution",
        lambda s: "not told" if s["failed_steps"] is None else str(s["failed_steps"]),
    ),
)


def _conditions(campaign: Campaign) -> list[tuple[str, list[str]]]:
    study = campaign.study
    helix, tower = study.controller.helix, study.controller.tower
    reference_clearance = helix.clearance_text(study.duration_s, tower)
    return [
        ("plan", [escape(study.plan.kind)]),
        ("trials", [str(study.n_trials)]),
        ("seed", [str(study.seed)]),
        ("duration", [f"{study.duration_s:g} s"]),
        ("gusts", [escape(study.gust.kind)]),
        ("vehicle", [escape(study.controller.vehicle.name)]),
        ("least clearance d<sub>min</sub>", [f"{study.controller.tower.min_clearance_m:g} m"]),
        ("reference clearance", [reference_clearance]),
    ]
