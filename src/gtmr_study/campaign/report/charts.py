# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The figures of a campaign in the browser, by plotly."""

from collections.abc import Callable

import numpy as np

from gtmr_monitor.report import look
from gtmr_monitor.report.charts import LIMIT, Chart, limit, plot, short
from gtmr_monitor.report.curves import add_box
from gtmr_monitor.report.look import mode_key, themed
from gtmr_study.campaign.figures import Campaign, why_no_channels
from gtmr_study.campaign.summary import channel_shares, wilson_interval

_WIDE = 1.6
"""Share of a chart of which two are beside each other."""
_SHARE = "share of trials at or below [%]"


def residual(campaign: Campaign) -> list[Chart]:
    """Draw the residual pooled over all trials as box plots, as in Fig. 2."""
    figure = plot(374, "", "s = d<sub>min</sub> − d<sub>T</sub> [m]", legend=False)
    for mode in campaign.flown:
        add_box(figure, mode, campaign.summary[mode]["residual_m"], themed(mode_key(mode)))
    limit(figure, 0.0, "violated above 0")
    return [
        Chart(
            figure,
            "Box plots of the residual",
            "Clearance residual",
            share=_WIDE,
        )
    ]


def least_clearance(campaign: Campaign) -> list[Chart]:
    """Draw how the trials' least clearance is distributed."""
    figure = plot(340, "least clearance of a trial [m]", _SHARE, hovermode="closest")
    d_min = campaign.study.controller.tower.min_clearance_m
    lowest = d_min
    for mode, rows in campaign.flown.items():
        ordered = rows.sort_values("min_clearance_m")
        values = ordered["min_clearance_m"].to_numpy(float)
        lowest = min(lowest, values[0])
        figure.add_scatter(
            x=short(values), y=short(100.0 * np.arange(1, values.size + 1) / values.size),
            customdata=ordered["trial"].to_numpy(int), mode="lines+markers", name=mode,
            line={"color": themed(mode_key(mode)), "shape": "hv", "width": 2}, marker_size=3,
            hovertemplate="trial %{customdata}: %{x:.3f} m<br>%{y:.1f} % of trials are at or "
            "below<extra>%{fullData.name}</extra>",
        )  # fmt: skip
    figure.add_vrect(
        x0=lowest - 0.01, x1=d_min, fillcolor=themed("bad"), opacity=0.12, line_width=0,
        layer="below",
    )  # fmt: skip
    figure.add_vline(x=d_min, line=LIMIT)
    figure.add_annotation(
        x=d_min, y=1.0, yref="y domain", text="d<sub>min</sub>, violated to the left",
        showarrow=False, xanchor="left", yanchor="top", xshift=4,
        font={"size": 12, "color": themed("quiet")}, bgcolor=themed("page"), opacity=0.85,
    )  # fmt: skip
    figure.update_yaxes(range=(0.0, 102.0))
    return [Chart(figure, "Distribution of least clearances", "Least clearance", share=_WIDE)]


def violations(campaign: Campaign) -> list[Chart]:
    """Draw the share of trials with a violation, with its 95 % interval."""
    modes = list(campaign.flown)
    figure = plot(374, "trials with a violation [%]", legend=False)
    for mode in modes:
        s = campaign.summary[mode]
        rate = 100.0 * s["violation_rate"]
        low, high = (100.0 * bound for bound in wilson_interval(s["violations"], s["trials"]))
        figure.add_scatter(
            x=[rate], y=[mode], mode="markers", name=mode,
            marker={"size": 10, "color": themed(mode_key(mode))},
            error_x={"type": "data", "symmetric": False, "array": [high - rate],
                     "arrayminus": [rate - low], "color": themed(mode_key(mode))},
            hovertemplate=f"{s['violations']} of {s['trials']}: {low:.1f} to {high:.1f} %"
            "<extra>%{fullData.name}</extra>",
        )  # fmt: skip
    figure.update_xaxes(range=(-1.0, 100.0))
    figure.update_yaxes(range=(len(modes) - 0.5, -0.5), dtick=1)
    return [Chart(figure, "Share of trials with a violation", "Violations", share=_WIDE)]


def channels(campaign: Campaign) -> list[Chart]:
    """Draw which channels drive the least clearance, with their 95 % intervals."""
    if why_no_channels(campaign):
        return []
    figure = plot(340, "share of variance by the channel alone [%]")
    shares = {mode: 100.0 * channel_shares(rows) for mode, rows in campaign.flown.items()}
    order = next(iter(shares.values())).index
    for mode, found in shares.items():
        share, low, high = (
            found[column].reindex(order).to_numpy(float) for column in ("share", "low", "high")
        )
        figure.add_bar(
            x=share, y=[look.MARGIN_LABELS[name] for name in order], orientation="h", name=mode,
            marker_color=themed(mode_key(mode)),
            customdata=np.column_stack([low, high]),
            error_x={"type": "data", "symmetric": False, "array": high - share,
                     "arrayminus": share - low, "color": themed("ink"), "thickness": 1.2,
                     "width": 3},
            hovertemplate="%{y}: %{x:.1f} %, between %{customdata[0]:.1f} and "
            "%{customdata[1]:.1f} %<extra>%{fullData.name}</extra>",
        )  # fmt: skip
    figure.update_xaxes(range=(0.0, 100.0))
    figure.update_yaxes(autorange="reversed", dtick=1)
    return [
        Chart(
            figure, "Shares of variance by channel", "What drives the least clearance", share=_WIDE
        )
    ]


def solve_times(campaign: Campaign) -> list[Chart]:
    """Draw the trials' solve times."""
    figure = plot(340, "time per controller step [ms]", _SHARE, hovermode="closest")
    for mode, rows in campaign.flown.items():
        for column, dash in (("solve_ms_median", "solid"), ("solve_ms_p99", "dot")):
            values = np.sort(rows[column].to_numpy(float))
            what = "median" if dash == "solid" else "99th percentile"
            figure.add_scatter(
                x=short(values), y=short(100.0 * np.arange(1, values.size + 1) / values.size),
                mode="lines", name=f"{mode}, {what}",
                line={"color": themed(mode_key(mode)), "dash": dash, "width": 2, "shape": "hv"},
                hovertemplate="%{x:.2f} ms<extra>%{fullData.name}</extra>",
            )  # fmt: skip
    figure.update_xaxes(type="log", dtick="D2")
    figure.update_yaxes(range=(0.0, 102.0))
    return [Chart(figure, "Solve times of each trial, distribution", "Solve times", share=_WIDE)]


CHARTS: dict[str, Callable[[Campaign], list[Chart]]] = {
    draw.__name__.replace("_", "-"): draw
    for draw in (least_clearance, residual, violations, channels, solve_times)
}
"""The charts of a campaign by name."""


def all_charts(campaign: Campaign) -> dict[str, list[Chart]]:
    """Draw what a campaign has trials enough for, by name."""
    drawn = {name: draw(campaign) for name, draw in CHARTS.items()}
    return {name: charts for name, charts in drawn.items() if charts}
