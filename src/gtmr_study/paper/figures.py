# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Table II, Fig. 1 and Fig. 2 of the paper, each with the paper's own values beside ours."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from gtmr_model import ReferencePath, Tower
from gtmr_monitor.report import look
from gtmr_monitor.report.drawing import new_figure
from gtmr_sim import FlightLog
from gtmr_study.campaign.figures import draw_boxes
from gtmr_study.paper.claims import PAPER, TRIALS

_PAPER_SHADE = "#8c8c8c"

TABLE_II_HEADS = ("controller", "least clearance", "trials with violation", "average solve time")


def table_ii_rows(summary: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    """Table II: the paper's rows and ours, as text under `TABLE_II_HEADS`."""
    rows = []
    for mode, paper in PAPER.items():
        ours = summary[mode]
        least_m = (paper.min_clearance_m, ours["min_clearance_m"])
        violating = (f"{paper.violations}/{TRIALS}", f"{ours['violations']}/{ours['trials']}")
        solve = (f"{paper.solve_ms:.1f} ms", f"{ours['solve_ms']['mean']:.2f} ms")
        for who, least, n, time in zip(("paper", "here"), least_m, violating, solve, strict=True):
            rows.append((f"{mode}, {who}", f"{least:.3f} m", n, time))
    return rows


def table_ii(summary: dict[str, Any]) -> Figure:
    """Draw Table II."""
    rows = table_ii_rows(summary)
    figure = new_figure(6.4, 1.7)
    axes = figure.subplots()
    axes.set_axis_off()
    table = axes.table(rows, colLabels=TABLE_II_HEADS, loc="center", cellLoc="left")
    table.auto_set_font_size(False)
    table.set_fontsize(9.0)
    table.scale(1.0, 1.35)
    for (row, _), cell in table.get_celld().items():
        cell.visible_edges = "B"
        cell.set_edgecolor(look.GRID if row else look.INK)
        if row % 2 == 1:
            cell.get_text().set_color(look.QUIET)
    axes.set_title("Table II, the paper's values and ours")
    return figure


def fig_1(logs: dict[str, FlightLog], tower: Tower, helix: ReferencePath) -> Figure:
    """Draw Fig. 1: flights under a steady wind, in space, from above and as clearance."""
    figure = new_figure(10.5, 4.0)
    grid = figure.add_gridspec(1, 3, width_ratios=(1.0, 0.9, 1.1))
    space = figure.add_subplot(grid[0], projection="3d")
    above, over_time = figure.add_subplot(grid[1]), figure.add_subplot(grid[2])
    some = next(iter(logs.values()))
    reference = helix.at(some.t, tower).position
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    x, y = tower.radius_m * np.cos(angle), tower.radius_m * np.sin(angle)
    height = np.array([reference[:, 2].min() - 0.2, reference[:, 2].max() + 0.2])
    space.plot_surface(
        np.tile(x, (2, 1)), np.tile(y, (2, 1)), np.repeat(height[:, None], angle.size, axis=1),
        color=look.TOWER, alpha=0.35, linewidth=0.0, rasterized=True,
    )  # fmt: skip
    dots: dict[str, Any] = {"color": look.QUIET, "linestyle": ":", "linewidth": 1.0}
    dots["label"] = "reference"
    space.plot(*reference.T, **dots)
    above.plot(*reference[:, :2].T, **dots)
    above.fill(x, y, color=look.TOWER)
    limit = tower.radius_m + tower.min_clearance_m
    above.plot(
        limit * np.cos(angle), limit * np.sin(angle), "--", color=look.LIMIT, linewidth=1.0,
        label="$d_{min}$",
    )  # fmt: skip
    for mode, log in logs.items():
        pen: dict[str, Any] = {"color": look.MODE_COLOURS[mode], "label": mode}
        space.plot(*log.x[:, :3].T, **pen)
        above.plot(*log.x[:, :2].T, **pen)
        over_time.plot(log.t, log.d_T, **pen)
    over_time.axhline(tower.min_clearance_m, color=look.LIMIT, linestyle="--", linewidth=1.0)
    over_time.plot(some.t, helix.clearance(some.t, tower), **dots)
    space.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    # Smaller, as the layout leaves no room for the labels of a third axis.
    space.set_box_aspect((1.0, 1.0, 1.0), zoom=0.85)
    above.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="From above")
    over_time.set(xlabel="time [s]", ylabel="clearance $d_T$ [m]", title="Clearance")
    over_time.margins(x=0.0)
    handles, labels = above.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def fig_2(summary: dict[str, Any]) -> Figure:
    """Draw Fig. 2: the residual's box plots, the paper's in grey beside ours."""
    figure = new_figure(6.4, 4.2)
    axes = figure.subplots()
    boxes, colours, labels = [], [], []
    for mode, row in PAPER.items():
        boxes += [row.residual_m, summary[mode]["residual_m"]]
        colours += [_PAPER_SHADE, look.MODE_COLOURS[mode]]
        labels += [f"{mode},\npaper", f"{mode},\nhere"]
    draw_boxes(axes, boxes, colours)
    axes.set_xticks(range(1, len(labels) + 1), labels)
    axes.set(ylabel="s = $d_{min} - d_T$ [m]", title="Fig. 2, the paper's values and ours")
    return figure
