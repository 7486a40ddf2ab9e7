# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The figures in the browser: interactive, drawn by plotly."""

from collections.abc import Callable
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from gtmr_monitor.report import look
from gtmr_monitor.report.look import Flown, Line

_FONT = {"family": "system-ui, 'Segoe UI', 'Helvetica Neue', Arial, sans-serif", "size": 13}
_TOP_PX, _BOTTOM_PX = 60, 60
_TICKS_MS = [digit * 10.0**power for power in range(-2, 5) for digit in (1, 2, 5)]
_LIMIT = {"color": look.LIMIT, "dash": "dash", "width": 1.5}


def trajectory(flown: Flown) -> go.Figure:
    """Draw the flights around the tower in space."""
    flown = look.moved(flown)
    first = flown[0][0]
    height, reference = look.heights(flown), look.reference(flown)
    figure = go.Figure()
    for radius, colour, opacity, name in (
        (first.tower.radius_m, look.TOWER, 0.9, "tower"),
        (first.tower.radius_m + first.tower.min_clearance_m, look.LIMIT, 0.1, "least clearance"),
    ):
        x, y, z = look.cylinder(radius, height)
        figure.add_surface(
            x=x, y=y, z=z, colorscale=[[0.0, colour], [1.0, colour]], opacity=opacity,
            showscale=False, showlegend=True, name=name, hoverinfo="skip",
        )  # fmt: skip
    pen = {"color": look.QUIET, "width": 2, "dash": "dot"}
    figure.add_scatter3d(
        **_xyz(reference), mode="lines", line=pen, name="reference", hoverinfo="skip"
    )
    for flight, line in flown:
        figure.add_scatter3d(
            **_xyz(flight.p), mode="lines", line=_pen(line, width=5), name=line.label,
            customdata=np.column_stack([flight.t, flight.clearance]),
            hovertemplate="%{customdata[0]:.2f} s, clearance %{customdata[1]:.3f} m",
        )  # fmt: skip
    wide, tall = 2.0 * np.abs(reference[:, :2]).max(), height[1] - height[0]
    figure.update_scenes(
        xaxis_title="x, east [m]",
        yaxis_title="y, north [m]",
        zaxis_title="z [m]",
        # A long climb would shrink a true-to-scale box to a needle.
        aspectmode="data" if tall <= 1.5 * wide else "cube",
        camera={"eye": {"x": 1.1, "y": -1.4, "z": 0.7}, "center": {"x": 0.0, "y": 0.0, "z": -0.1}},
    )
    return _finish(figure, 620)


def residual(flown: Flown) -> go.Figure:
    """Draw the clearance residual over time and as box plots, with the safety line."""
    figure = make_subplots(
        1, 2, column_widths=[0.76, 0.24], shared_yaxes=True, horizontal_spacing=0.04
    )
    for flight, line in look.moved(flown):
        _curve(
            figure, flight.t, flight.residual, line.label, _pen(line), ".3f} m", showlegend=None
        )
        quartiles = flight.residual_statistics["residual_m"]
        figure.add_box(
            x=[line.label], lowerfence=[quartiles["min"]], q1=[quartiles["q1"]],
            median=[quartiles["median"]], q3=[quartiles["q3"]], upperfence=[quartiles["max"]],
            name=line.label, legendgroup=line.label, showlegend=False,
            marker_color=line.colour, line_width=1.5, row=1, col=2,
        )  # fmt: skip
        for at, mode in flight.modes[1:]:
            figure.add_vline(x=at, line=_pen(line, dash="dot"), annotation_text=mode, row=1, col=1)
        for begin, end, colour, name in look.spans(flight):
            figure.add_vrect(
                x0=begin, x1=end, fillcolor=colour, opacity=0.4, line_width=0, row=1, col=1,
                annotation_text=name, annotation_position="bottom left",
            )  # fmt: skip
    for flight, line in flown:
        if (foreseen := flight.predictions) is not None:
            name, pen = f"{line.label}, foreseen", _pen(line, dash="dot", width=1.2)
            _curve(
                figure, foreseen.t, foreseen.residual, name, pen, ".3f} m", showlegend=None,
                legendgroup=None,
            )  # fmt: skip
    figure.add_hline(y=0.0, line=_LIMIT, row=1, col="all")
    figure.add_annotation(
        x=0.0, y=0.0, xref="x domain", yref="y", text="violated above 0", showarrow=False,
        xanchor="left", yanchor="bottom",
    )  # fmt: skip
    figure.update_xaxes(title_text="time [s]", row=1, col=1)
    figure.update_yaxes(title_text="s = d<sub>min</sub> − d<sub>T</sub> [m]", row=1, col=1)
    figure.update_yaxes(range=look.residual_range([flight for flight, _ in flown]))
    figure.update_layout(hovermode="x")
    return _finish(figure, 440)


def clearance(flown: Flown) -> go.Figure:
    """Draw the clearance of the centre and that of the airframe over time."""
    figure = make_subplots(1, 1)
    for flight, line in look.moved(flown):
        _curve(figure, flight.t, flight.clearance, line.label, _pen(line), ".3f} m")
    for flight, line, values in look.airframes(flown):
        pen = _pen(line, dash="dot", width=1.2)
        _curve(figure, flight.t, values, f"{line.label}, airframe", pen, ".3f} m")
    figure.add_hline(y=flown[0][0].tower.min_clearance_m, line=_LIMIT)
    figure.add_hline(y=0.0, line={"color": look.QUIET, "width": 1.0})
    figure.update_xaxes(title_text="time [s]")
    figure.update_yaxes(title_text="clearance [m]")
    figure.update_layout(hovermode="x")
    return _finish(figure, 380)


def margins(flown: Flown) -> go.Figure:
    """Draw the parts of the tightening: at the last stage over time, and over the horizon."""
    tightened = look.tightened(flown)
    rows = max(1, len(tightened))
    titles = [
        title
        for _, line in tightened
        for title in (f"Last stage, {line.label}", "Over the horizon, mean of the flight")
    ]
    figure = make_subplots(
        rows, 2, column_widths=[0.62, 0.38], shared_yaxes=True, horizontal_spacing=0.06,
        vertical_spacing=0.2 / rows, subplot_titles=titles,
    )  # fmt: skip
    if not tightened:
        figure.add_annotation(text="no tightening was recorded", showarrow=False)
    for row, (flight, _) in enumerate(tightened, start=1):
        active = flight.margins.total.any(axis=1)
        for name, part in look.margin_parts(flight.margins).items():
            columns = [
                (flight.margins.t, 1e3 * part[:, -1]),
                (np.arange(part.shape[1]), 1e3 * part[active].mean(axis=0)),
            ]
            for column, (x, y) in enumerate(columns, start=1):
                pen = {"width": 0, "color": look.MARGIN_COLOURS[name]}
                _curve(
                    figure, x, y, look.MARGIN_LABELS[name], pen, ".1f} mm", row, column,
                    stackgroup=f"{row}-{column}", fillcolor=pen["color"], legendgroup=name,
                )  # fmt: skip
        figure.update_xaxes(title_text="time [s]", row=row, col=1)
        figure.update_xaxes(title_text="stage i", row=row, col=2)
        figure.update_yaxes(title_text="margin [mm]", row=row, col=1)
    figure.update_layout(hovermode="x")
    return _finish(figure, 130 + 340 * rows, legend_below_px=60)


def solve_times(flown: Flown) -> go.Figure:
    """Draw the time per controller step: over the flight, and how it is distributed."""
    figure = make_subplots(
        1, 2, column_widths=[0.66, 0.34], shared_yaxes=True, horizontal_spacing=0.04
    )
    timed = [(flight, line) for flight, line in flown if flight.solve_ms.size]
    edges = look.solve_time_bins([flight for flight, _ in timed])
    for flight, line in timed:
        figure.add_scattergl(
            x=flight.t_solve, y=flight.solve_ms, mode="markers", name=line.label,
            marker={"size": 3, "color": line.colour, "opacity": 0.5}, legendgroup=line.label,
            hovertemplate="%{x:.2f} s: %{y:.2f} ms", row=1, col=1,
        )  # fmt: skip
        counts, _ = np.histogram(flight.solve_ms, edges)
        figure.add_scatter(
            x=np.repeat(counts, 2), y=np.repeat(edges, 2)[1:-1], mode="lines", line=_pen(line),
            fill="tozerox", name=line.label, legendgroup=line.label, showlegend=False,
            hovertemplate="%{x} steps near %{y:.2f} ms", row=1, col=2,
        )  # fmt: skip
    deadline = flown[0][0].deadline_ms
    if np.isfinite(deadline):
        figure.add_hline(y=deadline, line=_LIMIT, row=1, col="all")
        figure.add_annotation(
            x=1.0, y=np.log10(deadline), xref="x2 domain", yref="y2", showarrow=False,
            text="deadline T<sub>s</sub>", xanchor="right", yanchor="bottom",
        )  # fmt: skip
    figure.update_yaxes(type="log", tickvals=_TICKS_MS)
    figure.update_yaxes(title_text="solve time [ms]", row=1, col=1)
    duration_s = max(flight.duration_s for flight, _ in flown)
    figure.update_xaxes(title_text="time [s]", range=(0.0, duration_s), row=1, col=1)
    figure.update_xaxes(title_text="steps", row=1, col=2)
    figure.update_layout(legend_itemsizing="constant")
    return _finish(figure, 400)


def rotors(flown: Flown) -> go.Figure:
    """Draw the speed of every rotor, one panel per flight."""
    flown = look.moved(flown)
    figure = make_subplots(
        len(flown), 1, shared_xaxes=True, shared_yaxes="all", vertical_spacing=0.12 / len(flown),
        subplot_titles=[f"Rotor speeds, {line.label}" for _, line in flown],
    )  # fmt: skip
    for row, (flight, _) in enumerate(flown, start=1):
        n_rotors = flight.rotor_speed_hz.shape[1]
        for rotor, speed in enumerate(flight.rotor_speed_hz.T):
            # Opposite rotors often turn alike: the second must not hide the first.
            dash = "solid" if rotor < n_rotors / 2 else "dash"
            pen = {"color": look.rotor_colour(rotor), "width": 1.4, "dash": dash}
            name, group = f"rotor {rotor}", str(rotor)
            _curve(figure, flight.t_rotors, speed, name, pen, ".1f} Hz", row, legendgroup=group)
        figure.update_yaxes(title_text="rotor speed [Hz]", row=row, col=1)
    figure.update_xaxes(title_text="time [s]", row=len(flown), col=1)
    figure.update_layout(hovermode="x unified")
    return _finish(figure, 130 + 250 * len(flown), legend_below_px=60)


def attitude(flown: Flown) -> go.Figure:
    """Draw roll, pitch and the deviation of the heading from the tower."""
    flown = look.moved(flown)
    figure = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.05)
    for flight, line in flown:
        for row, (name, angle) in enumerate(look.angles(flight).items(), start=1):
            _curve(figure, flight.t, angle, line.label, _pen(line), ".2f} deg", row)
            figure.update_yaxes(title_text=f"{name} [deg]", row=row, col=1)
    figure.update_xaxes(title_text="time [s]", row=3, col=1)
    figure.update_layout(hovermode="x unified")
    return _finish(figure, 620)


CHARTS: dict[str, Callable[[Flown], go.Figure]] = {
    draw.__name__: draw
    for draw in (trajectory, residual, clearance, margins, solve_times, rotors, attitude)
}
"""The charts of a report by name."""


def _xyz(points: Any) -> dict[str, Any]:
    return dict(zip("xyz", points.T, strict=True))


def _pen(line: Line, **other: Any) -> dict[str, Any]:
    return {"color": line.colour, "dash": line.dash, "width": 1.8} | other


def _curve(
    figure: go.Figure, x: Any, y: Any, name: str, pen: dict[str, Any], unit: str,
    row: int = 1, column: int = 1, **other: Any,
) -> None:  # fmt: skip
    """Add a curve to a panel; only the first panel has its name in the legend."""
    figure.add_scatter(
        x=x, y=y, mode="lines", name=name, line=pen, hovertemplate="%{y:" + unit, row=row,
        col=column, **{"legendgroup": name, "showlegend": row == column == 1} | other,
    )  # fmt: skip


def _finish(figure: go.Figure, height_px: int, legend_below_px: int = 0) -> go.Figure:
    """Give a figure its size and looks; the legend stands above it, or that far below."""
    legend = {"orientation": "h", "xanchor": "left", "x": 0.0, "yanchor": "bottom", "y": 1.02}
    plot_px = height_px - _TOP_PX - _BOTTOM_PX - legend_below_px
    if legend_below_px:
        legend |= {"yanchor": "top", "y": -legend_below_px / plot_px}
    # Titles of panels are annotations above the plot, centred unless told otherwise.
    for panel, annotation in zip(
        figure.select_xaxes(), figure.select_annotations({"yanchor": "bottom"}), strict=False
    ):
        if annotation.yref == "paper":
            annotation.update(x=panel.domain[0], xanchor="left")
    figure.update_layout(
        template="plotly_white",
        height=height_px,
        font=_FONT | {"color": look.INK},
        margin={"l": 70, "r": 20, "t": _TOP_PX, "b": _BOTTOM_PX + legend_below_px},
        legend=legend,
    )
    figure.update_xaxes(gridcolor=look.GRID, linecolor=look.QUIET, zeroline=False)
    figure.update_yaxes(gridcolor=look.GRID, linecolor=look.QUIET, zeroline=False)
    return figure
