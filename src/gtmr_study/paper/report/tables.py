# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the results of a reproduction depend on, in tables."""

from typing import Any

from gtmr_model import CHANNELS
from gtmr_monitor.report import look
from gtmr_monitor.report.html import signed
from gtmr_nmpc import PAPER_MODES
from gtmr_study.paper.claims import PAPER
from gtmr_study.paper.claims_table import markdown_table

Table = list[list[str]]
"""Titles of the columns, then the rows; plain text."""


def sensitivity_markdown(results: dict[str, Any]) -> str:
    """Write what the results depend on."""
    return "\n".join(
        f"## {title}\n\n{text}\n\n{markdown_table(rows)}"
        for title, text, rows in sections(results)
    )


def one_value_at_a_time(results: dict[str, Any]) -> Table:
    """Lay out how a change of each value that the paper leaves out moves both rows."""
    heads = ["changed"]
    for mode, distance in zip(PAPER_MODES, ("nominal", "both"), strict=True):
        heads += [f"{mode}: {what}" for what in ("violating", "least [m]", "q1, median, q3 [m]")]
        heads.append(f"distance, {distance}")
    rows = [heads]
    for variant in results["variants"]:
        cells = [variant["name"]]
        for mode, distance in zip(PAPER_MODES, ("nominal", "both"), strict=True):
            summary = variant["summary"][mode]
            residual_m = [summary["residual_m"][key] for key in ("q1", "median", "q3")]
            cells += [
                f"{summary['violations']} of {summary['trials']}",
                f"{summary['min_clearance_m']:.3f}",
                ", ".join(map(signed, residual_m)),
                f"{variant['distance'][distance]:.2f}",
            ]
        rows.append(cells)
    return rows


def size_of_the_tightening(results: dict[str, Any]) -> Table:
    """Lay out the parts of the margin, and how close robust flights come with it.

    One row for every reading of the paper, and for every eps_s.
    """
    parts = [*CHANNELS, "eps_s", "gust", "total"]
    labels = [{**look.MARGIN_LABELS, "total": "α_N"}[part] for part in parts]
    rows = [["margin", *labels, "least [m]", "median [m]"]]
    for variant in results["variants"]:
        if variant["parameter"] not in ("", "eps_s_m"):
            continue
        flown = variant["summary"]["robust"]
        margins = [f"{1e3 * variant['margins_m'][part]:.1f}" for part in parts]
        clearances = [f"{flown[key]:.3f}" for key in ("min_clearance_m", "median_clearance_m")]
        rows.append([variant["name"], *margins, *clearances])
    return rows


def alpha_by_speed(results: dict[str, Any]) -> Table:
    """Lay out the tightening at the last stage against the helix's speed."""
    rows = results["alpha_by_helix_speed"]
    return [
        ["helix speed [m/s]", *(f"{row['speed_m_s']:g}" for row in rows)],
        ["α_N [mm]", *(f"{1e3 * row['alpha_n_m']:.1f}" for row in rows)],
    ]


def sections(results: dict[str, Any]) -> list[tuple[str, str, Table]]:
    """List the tables of what results depend on: title, text, table."""
    found = []
    if results["variants"]:
        flown = results["variants"][0]["summary"]["nominal"]["trials"]
        found = [
            (
                "One change at a time",
                f"{flown} trials a mode with the same mismatch and gusts, in shorter flights than "
                "the campaign's. Distance is the root mean square of the deviations from the "
                "paper, in tolerances: from its nominal rows, and from both modes' rows.",
                one_value_at_a_time(results),
            ),
            (
                "Size of the tightening",
                "Parts of the margin at the last stage [mm], averaged over a turn around the "
                "tower, and the clearance of robust flights with it. The paper's robust row asks "
                f"for a least clearance of {PAPER['robust'].min_clearance_m:g} m and a median of "
                "0.39 m.",
                size_of_the_tightening(results),
            ),
        ]
    return [
        *found,
        (
            "Tightening and speed of the helix",
            "Margin at the last stage, averaged over a turn around the tower.",
            alpha_by_speed(results),
        ),
    ]
