# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The report of campaigns: one HTML page that needs nothing else."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

from gtmr_monitor.report.charts import charts_html
from gtmr_monitor.report.drawing import save
from gtmr_monitor.report.html import Card, cards, page, signed, table, verdict
from gtmr_monitor.report.look import mode_key, themed
from gtmr_study.campaign.figures import Campaign, figures_of, why_no_channels
from gtmr_study.campaign.report.charts import all_charts
from gtmr_study.campaign.report.worst import LISTED, WorstTrial, write_worst

CAPTIONS = {
    "residual": "s = d<sub>min</sub> − d<sub>T</sub>, pooled over all instants of all trials; "
    "below the dashed line the clearance constraint holds. Boxes show quartiles, whiskers the "
    "extremes.",
    "least-clearance": "Each trial counts with the least clearance of its flight; point at a step "
    "to see which trial it is.",
    "violations": "A trial counts if any instant violates the clearance constraint; the interval "
    "is Wilson's, of 95 %.",
    "channels": "How much of the variance of the least clearance is explained by one channel of "
    "the true mismatch alone, with 95 % intervals. What is missing to 100 % is the interplay of "
    "channels, and gusts.",
    "solve-times": "Preparation and feedback together, wall time, with as many flights at once "
    "as there were workers.",
}
"""Explanation of every figure."""

Value = Callable[[dict[str, Any]], str]


def write_campaign_report(folders: Sequence[Path], out_html: Path) -> list[Path]:
    """Write a report on campaigns, one below the other; give its file, then its figures' files.

    Beside it comes a folder ``<stem>-worst`` with what flies the worst trials again.
    """
    campaigns = [Campaign.read(folder) for folder in folders]
    names = ", ".join(campaign.name for campaign in campaigns)
    # One campaign's files need no number.
    prefixes = [
        out_html.stem if len(campaigns) == 1 else f"{out_html.stem}-{number}"
        for number in range(1, len(campaigns) + 1)
    ]
    body = "\n".join(
        campaign_section(
            campaign,
            "Results" if len(campaigns) == 1 else campaign.name,
            out_html.with_name(f"{prefix}-worst"),
            "" if len(campaigns) == 1 else f"of-{number}-",
        )
        for number, (prefix, campaign) in enumerate(zip(prefixes, campaigns, strict=True), start=1)
    )
    out_html.write_text(page(f"Campaign {names}", body, charts=True), encoding="utf-8")
    paths = [out_html]
    for prefix, campaign in zip(prefixes, campaigns, strict=True):
        for name, draw in figures_of(campaign).items():
            paths += save(draw, out_html.with_name(f"{prefix}-{name}"), ("png",))
    return paths


def campaign_section(campaign: Campaign, title: str, worst_folder: Path, prefix: str = "") -> str:
    """Describe a campaign in HTML under a title: verdicts, charts, worst trials, numbers.

    The worst trials are written into a folder beside the page; ids of charts begin with a prefix.
    """
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
        return f"<h2>{escape(title)}</h2>{warnings}<p>No trial has flown yet.</p>"
    heads = [(mode, themed(mode_key(mode))) for mode in flown]
    charts = [
        replace(chart, caption=CAPTIONS[name])
        for name, drawn in all_charts(campaign).items()
        for chart in drawn
    ]
    return f"""<h2>{escape(title)}</h2>
{warnings}
{cards(_card(mode, s) for mode, s in flown.items())}
{charts_html(prefix + "campaign", charts)}
<p>{why_no_channels(campaign)}</p>
{_worst_html(write_worst(campaign, worst_folder))}
<div class="tables">
<section><h3>Summary</h3>
{table(heads, [(name, [cell(s) for s in flown.values()]) for name, cell in _ROWS])}</section>
<section><h3>Conditions</h3>
{table([], _conditions(campaign))}</section>
</div>"""


def _card(mode: str, summary: dict[str, Any]) -> Card:
    violations, trials = summary["violations"], summary["trials"]
    low, high = (100.0 * bound for bound in summary["violation_rate_95"])
    said = f"{violations} of {trials} trials violated" if violations else "none violated"
    return Card(
        mode,
        f"{summary['min_clearance_m']:.3f} m",
        f"least clearance of {trials} trials<br>{verdict(not violations, said)}<br>"
        f"rate {low:.1f} to {high:.1f} % with 95 % confidence",
        mode_key(mode),
    )


def _worst_html(worst: dict[str, list[WorstTrial]]) -> str:
    """List the worst trials of each mode, with what flies each again."""
    titles = ("least clearance [m]", "mass", "thrust", "wind bias x, y, z [N]", "fly it again")
    rows = []
    for mode, trials in worst.items():
        for trial in trials:
            row = trial.row
            least = f"{row['min_clearance_m']:.3f}"
            wind = ", ".join(
                f"{row[name]:.2f}".replace("-", "−") for name in ("w_bx", "w_by", "w_bz")
            )
            shares = [
                f"{100.0 * row[name]:.1f} %".replace("-", "−") for name in ("mass", "thrust")
            ]
            again = (
                f'<code class="command">{escape(trial.command)}</code>'
                if trial.command
                else "a controller of one's own is in no file"
            )
            seen = verdict(not row["violated"], least)
            rows.append((f"{escape(mode)}, trial {row['trial']}", [seen, *shares, wind, again]))
    return (
        f"<h3>Worst trials</h3>\n<p>The {LISTED} of each mode with the smallest least clearance, "
        "and their true mismatch. The commands are for the folder of this page.</p>\n"
        + table([(title, "") for title in titles], rows)
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
