# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The paper's figures in the browser, by plotly."""

from dataclasses import replace
from typing import Any

import numpy as np

from gtmr_monitor.flight import Flight
from gtmr_monitor.report import curves, look
from gtmr_monitor.report.charts import Chart, curve, limit, plot
from gtmr_monitor.report.look import themed
from gtmr_study.paper.claims import PAPER


def fig_1(flights: list[Flight]) -> list[Chart]:
    """Draw Fig. 1: flights under a steady wind, in space, from above and as clearance."""
    flown = list(zip(flights, look.lines(flights), strict=True))
    (over_time,) = curves.clearance(flown)
    # Wide enough for a row of its own.
    return [*curves.trajectory(flown), replace(over_time, title="Clearance", share=3.0)]


def fig_2(summary: dict[str, Any]) -> list[Chart]:
    """Draw Fig. 2: the residual's box plots, the paper's in grey beside ours."""
    figure = plot(340, "", "s = d<sub>min</sub> − d<sub>T</sub> [m]", legend=False)
    for mode, row in PAPER.items():
        curves.add_box(figure, f"{mode}, paper", row.residual_m, themed("paper"))
        box = summary[mode]["residual_m"]
        curves.add_box(figure, f"{mode}, here", box, themed(look.mode_key(mode)))
    limit(figure, 0.0, "violated above 0")
    return [Chart(figure, "Box plots of the residual, the paper's and ours")]


def first_order(figures: dict[str, Any]) -> list[Chart]:
    """Draw by stage how much of each margin is used."""
    charts = []
    highest = 1.1
    for part, title in (("parametric", "Parametric"), ("gust", "Gust"), ("both", "Both")):
        shown = figures[part]
        stages = np.arange(1, len(shown["max"]) + 1)
        figure = plot(280, "stage i", "change / margin [-]", hovermode="x unified")
        for key, dash in (("max", "solid"), ("p99", "dash"), ("median", "dot")):
            line = {"color": themed("robust"), "dash": dash, "width": 2}
            curve(figure, stages, shown[key], f"flights, {key}", line, ".2f}")
            highest = max(highest, 1.15 * max(shown[key]))
        if (worst := figures.get(f"worst_{part}")) is not None:
            for key, dash in (("max", "solid"), ("median", "dash")):
                line = {"color": themed("nominal"), "dash": dash, "width": 2}
                curve(figure, stages, worst[key], f"worst case, {key}", line, ".2f}")
                highest = max(highest, 1.15 * max(worst[key]))
        limit(figure, 1.0, "the margin")
        charts.append(Chart(figure, f"{title} change of the clearance over its margin", title))
    for chart in charts:
        chart.figure.update_yaxes(range=(0.0, highest))
    return charts
