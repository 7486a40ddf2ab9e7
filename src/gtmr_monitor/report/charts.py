# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""How figures in the browser look, whatever they show: one plot each, drawn by plotly."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike, NDArray

from gtmr_monitor.report.html import key
from gtmr_monitor.report.look import themed

FONT = "system-ui, 'Segoe UI', 'Helvetica Neue', Arial, sans-serif"
LIMIT = {"color": themed("limit"), "dash": "dash", "width": 1.5}
"""Pen of a bound."""
LEGEND_PX = 34
"""Height of a row of the legend."""
_LEFT_PX, _RIGHT_PX, _TOP_PX, _BOTTOM_PX = 64, 14, 12, 48


@dataclass(frozen=True)
class Chart:
    """A figure with what is written about it on its page."""

    figure: go.Figure
    """One plot; its height is in its layout, its width is that of its place."""
    says: str
    """What it shows, in plain text, for those who do not see it."""
    title: str = ""
    """What is written above it, where its section has several."""
    caption: str = ""
    """What is written below it, in HTML."""
    share: float = 1.0
    """Its part of the width beside its neighbours; on a narrow page each has a row."""
    keys: Mapping[str, str] = field(default_factory=dict)
    """Names and colours of what it shows, where it has no legend of its own."""


def plot(
    height_px: int, x_title: str = "", y_title: str = "", *, legend: bool = True, **layout: Any
) -> go.Figure:
    """Make an empty plot in the style of all pages.

    Colours are those of `look.themed`, so that the page can change its theme.
    """
    axis = {
        "gridcolor": themed("grid"),
        "linecolor": themed("quiet"),
        "zeroline": False,
        "automargin": True,
        "title": {"standoff": 8},
    }
    figure = go.Figure(
        layout={
            "template": "none",
            "height": height_px + (LEGEND_PX if legend else 0),
            "font": {"family": FONT, "size": 13, "color": themed("ink")},
            "paper_bgcolor": themed("page"),
            "plot_bgcolor": themed("page"),
            "margin": {
                "l": _LEFT_PX, "r": _RIGHT_PX, "t": _TOP_PX + (LEGEND_PX if legend else 0),
                "b": _BOTTOM_PX,
            },
            "showlegend": legend,
            "legend": {
                "orientation": "h", "xanchor": "left", "x": 0.0, "yanchor": "bottom", "y": 1.0,
                "itemsizing": "trace",
            },
            "hoverlabel": {
                "bgcolor": themed("raised"), "bordercolor": themed("quiet"),
                "font": {"family": FONT, "size": 13, "color": themed("ink")}, "namelength": -1,
            },
            "xaxis": axis, "yaxis": axis,
        }
    )  # fmt: skip
    figure.update_xaxes(title_text=x_title)
    figure.update_yaxes(title_text=y_title)
    figure.update_layout(**layout)
    return figure


def over_time(
    height_px: int, y_title: str, duration_s: float, *, legend: bool = True, **layout: Any
) -> go.Figure:
    """Make an empty plot over the time of a flight [s]; zooming one zooms all of a page."""
    figure = plot(height_px, "time [s]", y_title, legend=legend, **layout)
    # A plot of a page's script is known by this to have that axis.
    figure.update_layout(meta={"time": True}, hovermode="x unified")
    figure.update_xaxes(
        range=(0.0, duration_s), unifiedhovertitle={"text": "<b>%{x:.2f} s</b>"},
        showspikes=True, spikemode="across", spikethickness=1, spikedash="solid",
        spikecolor=themed("quiet"),
    )  # fmt: skip
    return figure


def curve(
    figure: go.Figure, x: ArrayLike, y: ArrayLike, name: str, pen: dict[str, Any], unit: str,
    **other: Any,
) -> None:  # fmt: skip
    """Add a curve; ``unit`` ends its number in the hover, such as ``.3f} m``."""
    figure.add_scatter(
        x=short(x), y=short(y), mode="lines", name=name, line=pen,
        hovertemplate="%{y:" + unit, **other,
    )  # fmt: skip


def limit(figure: go.Figure, value: float, text: str, above: bool = True) -> None:
    """Draw a bound as a horizontal line with words at its right end."""
    figure.add_hline(y=value, line=LIMIT)
    kind = figure.layout.yaxis.type
    figure.add_annotation(
        x=1.0, y=np.log10(value) if kind == "log" else value, xref="x domain", yref="y",
        text=text, showarrow=False, xanchor="right", yanchor="bottom" if above else "top",
        font={"size": 12, "color": themed("quiet")}, bgcolor=themed("page"), opacity=0.85,
    )  # fmt: skip


def short(values: ArrayLike) -> NDArray[Any]:
    """Give numbers in single precision, which is finer than a pixel and half as long."""
    array = np.asarray(values)
    return array.astype(np.float32) if array.dtype == np.float64 else array


def charts_html(name: str, charts: Sequence[Chart]) -> str:
    """Put charts beside each other into a page that has the script of `html.page`."""
    drawn = "\n".join(_html(f"{name}-{k}", chart) for k, chart in enumerate(charts))
    keys = {text: colour for chart in charts for text, colour in chart.keys.items()}
    legend = " ".join(f"<span>{key(colour)}{escape(text)}</span>" for text, colour in keys.items())
    legend = f'<p class="keys">{legend}</p>\n' if keys else ""
    return f'{legend}<div class="charts" id="{name}">\n{drawn}\n</div>'


def _html(name: str, chart: Chart) -> str:
    height_px = chart.figure.layout.height
    title = f"<h3>{escape(chart.title)}</h3>" if chart.title else ""
    caption = f"<figcaption>{chart.caption}</figcaption>" if chart.caption else ""
    # Nothing inside may end the script element.
    spec = str(chart.figure.to_json()).replace("<", r"\u003c")
    return (
        f'<figure style="--share: {chart.share:g}">'
        f'{title}<div class="chart" id="{name}" role="group" aria-label="{escape(chart.says)}" '
        f'style="min-height: {height_px}px"></div>'
        f'<script type="application/json" data-chart="{name}">{spec}</script>{caption}</figure>'
    )
