# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Clearance against tracking error, a curve a controller: on paper, and in the browser."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gtmr_monitor.report import look
from gtmr_monitor.report.charts import LEGEND_PX, LIMIT, Chart, plot
from gtmr_monitor.report.drawing import new_figure, save
from gtmr_monitor.report.look import controller_key, themed
from gtmr_study.arena.table import Result, is_flown

FIGURE = "clearance-against-tracking"
"""Name of the figure's files without their ending."""
MOST_RMS_MM = 2000.0
"""What tracks worse is lost, and not drawn [mm]."""
LEAST_CLEARANCE_M = -0.1
"""What comes closer went far into the tower, and is not drawn [m]."""
HEIGHT_PX, ROW_PX = 440, 20
X_TITLE = "radial tracking error, RMS after 5 s [mm]"
Standing = Literal["flown", "off", "violated", "errors"]


class Sign(NamedTuple):
    """How a point is marked, besides its colour."""

    shape: str
    """What it looks like."""
    says: str
    """What it means."""
    paper: str
    """Matplotlib's name of it."""
    browser: str
    """Plotly's."""
    filled: bool
    """Whether matplotlib fills it."""


SIGNS: dict[Standing, Sign] = {
    "flown": Sign("full circle", "no violation, at d_ref", "o", "circle", True),
    "off": Sign("open circle", "no violation, but not at d_ref", "o", "circle-open", False),
    "violated": Sign("cross", "violation in some trial", "x", "x-thin-open", True),
    "errors": Sign("triangle", "some flights in error", "v", "triangle-down-open", False),
}
DASHES: tuple[tuple[look.Dash, str], ...] = (("solid", "-"), ("dash", "--"), ("dot", ":"))
"""Lines as plotly and as matplotlib call them."""


def standing(result: Result) -> Standing:
    """Say how a cell stands."""
    if result["errors"]:
        return "errors"
    if result["violations"]:
        return "violated"
    return "flown" if is_flown(result) else "off"


def curves(results: Sequence[Result], world: str) -> dict[str, list[Result]]:
    """Cells of a world that can be drawn, by controller, by distance."""
    found: dict[str, list[Result]] = {}
    for result in results:
        if result["world"] == world:
            found.setdefault(result["controller"], [])
            if is_drawn(result):
                found[result["controller"]].append(result)
    return found


def is_drawn(result: Result) -> bool:
    """Tell whether a cell has a place in the figure; what is lost has none."""
    rms_m, least_m = result["radial_rms_settled_m"], result["min_clearance_m"]
    if rms_m is None or least_m is None:
        return False
    return bool(1e3 * rms_m <= MOST_RMS_MM and least_m >= LEAST_CLEARANCE_M)


def on_paper(results: Sequence[Result], d_min_m: float) -> Figure:
    """Draw the figure, a panel a world."""
    worlds = list(dict.fromkeys(result["world"] for result in results))
    figure = new_figure(3.6 * len(worlds) + 2.4, 4.6)
    panels = figure.subplots(1, len(worlds), sharey=True, squeeze=False)[0]
    for axes, world in zip(panels, worlds, strict=True):
        shown = curves(results, world)
        for number, (controller, cells) in enumerate(shown.items()):
            colour = look.LIGHT[controller_key(controller)]
            x = [1e3 * cell["radial_rms_settled_m"] for cell in cells]
            y = [cell["min_clearance_m"] for cell in cells]
            axes.plot(x, y, color=colour, linestyle=DASHES[number % len(DASHES)][1])
            for x_mm, y_m, cell in zip(x, y, cells, strict=True):
                sign = SIGNS[standing(cell)]
                axes.plot(
                    x_mm, y_m, sign.paper, color=colour, markersize=6,
                    markerfacecolor=colour if sign.filled else "white",
                )  # fmt: skip
        axes.axhline(d_min_m, color=look.LIMIT, linestyle=(0, (4, 2)), linewidth=1.2)
        low, high = _decades([cell for cells in shown.values() for cell in cells])
        axes.set(
            xscale="log", xlim=(10.0**low, 10.0**high), xlabel="radial RMS after 5 s [mm]",
            title=f"World {world}",
        )  # fmt: skip
        axes.xaxis.set_major_formatter("{x:g}")
    panels[0].set_ylabel("least clearance of any trial $d_T$ [m]")
    panels[0].annotate(
        "$d_{min}$", (0.0, d_min_m), (4.0, 3.0), xycoords=("axes fraction", "data"),
        textcoords="offset points", fontsize=8,
    )  # fmt: skip
    figure.legend(handles=_legend(results, worlds[0]), loc="outside right upper", fontsize=8)
    return figure


def _legend(results: Sequence[Result], world: str) -> list[Line2D]:
    handles: list[Line2D] = []
    for number, controller in enumerate(curves(results, world)):
        pen: Any = {"linestyle": DASHES[number % len(DASHES)][1], "marker": "o"}
        colour = look.LIGHT[controller_key(controller)]
        handles.append(Line2D([], [], color=colour, label=controller, **pen))
    for sign in SIGNS.values():
        fill = look.QUIET if sign.filled else "white"
        pen = {"linestyle": "", "marker": sign.paper, "markerfacecolor": fill}
        handles.append(Line2D([], [], color=look.QUIET, label=sign.says, **pen))
    return handles


def write_figure(results: Sequence[Result], d_min_m: float, folder: Path) -> list[Path]:
    """Draw the figure into a folder, as PNG and SVG."""
    return save(lambda: on_paper(results, d_min_m), folder / FIGURE, ("png", "svg"))


def in_browser(results: Sequence[Result], world: str, d_min_m: float) -> Chart:
    """Draw a panel of it; each point knows its cell."""
    shown = curves(results, world)
    # The legend takes a row for some four of them.
    height_px = HEIGHT_PX + ROW_PX * (len(shown) // 4)
    figure = plot(height_px, X_TITLE, "least clearance of any trial [m]", hovermode="closest")
    drawn = [cell for cells in shown.values() for cell in cells]
    for number, (controller, cells) in enumerate(shown.items()):
        colour = themed(controller_key(controller))
        figure.add_scatter(
            x=[1e3 * cell["radial_rms_settled_m"] for cell in cells] or [None],
            y=[cell["min_clearance_m"] for cell in cells] or [None],
            mode="lines+markers", name=controller,
            line={"color": colour, "width": 1.5, "dash": DASHES[number % len(DASHES)][0]},
            marker={"size": 10, "color": colour, "line": {"width": 2.0, "color": colour},
                    "symbol": [SIGNS[standing(cell)].browser for cell in cells]},
            customdata=[name_of(cell) for cell in cells],
            text=[_hover(cell) for cell in cells], hovertemplate="%{text}<extra></extra>",
        )  # fmt: skip
    figure.add_hline(y=d_min_m, line=LIMIT)
    figure.add_annotation(
        x=0.0, y=d_min_m, xref="x domain", yref="y", text="d<sub>min</sub>, violated below",
        showarrow=False, xanchor="left", yanchor="top", xshift=4,
        font={"size": 12, "color": themed("quiet")},
    )  # fmt: skip
    figure.update_xaxes(type="log", dtick="D2", range=_decades(drawn))
    lost = [
        f"{cell['controller']} at {cell['d_ref_m']:.2f} m"
        for cell in results
        if cell["world"] == world and not is_drawn(cell)
    ]
    return Chart(
        figure,
        f"Least clearance against tracking error in the world {world}",
        "Clearance against tracking error",
        caption=f"Not drawn, since they were lost or none ended: {', '.join(lost)}."
        if lost
        else "",
        share=1.5,
    )


def trials_in_browser(world: str, d_min_m: float) -> Chart:
    """Make the chart of one cell's trials, which the page's script fills."""
    figure = plot(HEIGHT_PX + LEGEND_PX, X_TITLE, "least clearance [m]", legend=False)
    figure.update_layout(hovermode="closest")
    figure.add_scatter(
        x=[None], y=[None], mode="markers", name=world,
        marker={"size": 7, "color": themed("other"), "opacity": 0.75},
        hovertemplate="%{text}<extra></extra>",
    )  # fmt: skip
    figure.add_hline(y=d_min_m, line=LIMIT)
    return Chart(figure, f"Trials of one point in the world {world}", "Its trials", share=1.0)


def name_of(result: Result) -> str:
    """Name a cell within its world, for the page's script."""
    d_ref_m = result["d_ref_m"]
    distance = f"{d_ref_m:.2f}" if d_ref_m == round(d_ref_m, 2) else f"{d_ref_m:g}"
    return f"{result['controller']} at {distance} m"


def _decades(drawn: Sequence[Result]) -> tuple[float, float]:
    """Limits of the logarithmic axis, as powers of ten."""
    if not drawn:
        return 0.0, 2.0
    told = [max(1e3 * cell["radial_rms_settled_m"], 1e-2) for cell in drawn]
    return math.log10(0.7 * min(told)), math.log10(1.5 * max(told))


def _hover(cell: Result) -> str:
    low, high = (100.0 * bound for bound in cell["violations_95"])
    lines = [
        f"<b>{cell['controller']}, d<sub>ref</sub> = {cell['d_ref_m']:.2f} m</b>",
        f"{cell['violations']} of {cell['trials']} trials violate ({low:.1f} to {high:.1f} %)",
        f"d<sub>T</sub> least {cell['min_clearance_m']:.3f} m, mean "
        f"{cell['mean_clearance_m']:.3f} m",
        f"RMS {1e3 * cell['radial_rms_settled_m']:.1f} mm, effort {cell['u_rms_hz_s']:.0f} Hz/s, "
        f"{cell['step_ms']:.2f} ms a step",
        SIGNS[standing(cell)].says,
    ]
    return "<br>".join(lines)
