# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The page of a reproduction: what was met, figures, what results depend on, the campaign."""

from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from gtmr_monitor.flight import Flight
from gtmr_monitor.report.charts import charts_html
from gtmr_monitor.report.html import Card, cards, page, table, verdict
from gtmr_study.campaign.figures import Campaign
from gtmr_study.campaign.report.page import campaign_section
from gtmr_study.paper import figures
from gtmr_study.paper.claims_table import MET, NOT_MET, Claim
from gtmr_study.paper.report import charts
from gtmr_study.paper.report.tables import Table, sections

WORST_FOLDER = "worst"
"""Beside the page: what flies the worst trials again."""


def write_page(
    out_html: Path,
    campaign: Campaign,
    claims: Sequence[Claim],
    results: dict[str, Any],
    flights: list[Flight],
) -> None:
    """Write the page: claims, figures of the paper, and the campaign that was flown.

    ``flights`` are those of Fig. 1.
    """
    tables = "\n".join(
        f"<h2>{escape(title)}</h2>\n<p>{escape(text)}</p>\n{_html(rows)}"
        for title, text, rows in sections(results)
    )
    summary = results["summary"]
    section = campaign_section(campaign, "The campaign", out_html.parent / WORST_FOLDER)
    body = f"""{_count(claims)}
<h2>Claims of the paper</h2>
{_claims(claims)}
<h2>Table II</h2>
<p>The paper's solve times are those of MATLAB on another machine.</p>
{_html([list(figures.TABLE_II_HEADS), *map(list, figures.table_ii_rows(summary))])}
<h2>Fig. 1</h2>
<p>Under a wind bias of [0.6, 0.4, 0.0] N. The paper gives this figure as a drawing, without
numbers to compare with.</p>
{charts_html("fig-1", charts.fig_1(flights))}
<h2>Fig. 2</h2>
<p>The paper's boxes (grey) are drawn from the coordinates of its figure.</p>
{charts_html("fig-2", charts.fig_2(summary))}
<h2>How much of the margins is used</h2>
<p>Plans of the robust controller flown open loop: the change of the clearance over the margin that
should bound it. Above the dashed line the margin is exceeded.</p>
{charts_html("first-order", charts.first_order(results["first_order"]))}
{tables}
{section}"""
    out_html.write_text(page("Reproduction of the paper", body, charts=True), encoding="utf-8")


def _count(claims: Sequence[Claim]) -> str:
    """Say first how many claims are met, how many are not, and how many are neither."""
    counts = Counter(claim.verdict for claim in claims)
    other = {name: n for name, n in counts.items() if name not in (MET, NOT_MET)}
    told = ", ".join(f"{n} {name}" for name, n in other.items())
    return cards(
        [
            Card("met", verdict(True, str(counts[MET])), f"of {len(claims)} claims", "good"),
            Card("not met", verdict(False, str(counts[NOT_MET])), "listed below", "bad"),
            Card("neither", str(sum(other.values())), escape(told) or "none", "quiet"),
        ]
    )


def _claims(claims: Sequence[Claim]) -> str:
    heads = [(head, "") for head in ("verdict", "paper", "here", "command")]
    rows = [
        (
            escape(claim.claim),
            [
                _verdict(claim.verdict),
                escape(claim.paper),
                escape(claim.here),
                f"<code>{escape(claim.command)}</code>",
            ],
        )
        for claim in claims
    ]
    return table(heads, rows)


def _verdict(text: str) -> str:
    if text in (MET, NOT_MET):
        return verdict(text == MET, escape(text))
    return f'<span class="verdict">{escape(text)}</span>'


def _html(rows: Table) -> str:
    (_, *heads), *rest = rows
    cells = [(escape(row[0]), [escape(cell) for cell in row[1:]]) for row in rest]
    return f'<div class="wide">{table([(head, "") for head in heads], cells)}</div>'
