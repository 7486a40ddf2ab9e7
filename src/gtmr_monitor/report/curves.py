# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""What the flights were like over time, in the browser."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from gtmr_monitor.flight import Flight
from gtmr_monitor.report import look
from gtmr_monitor.report.charts import Chart, curve, limit, over_time, plot, short
from gtmr_monitor.report.decimation import kept
from gtmr_monitor.report.look import Flown, Line, themed
from gtmr_monitor.report.space import trajectory

Array = NDArray[np.float64]

_TICKS_MS = [digit * 10.0**power for power in range(-2, 5) for digit in (1, 2, 5)]
_ABOVE_LIMIT = "violated above 0"


def residual(flown: Flown) -> list[Chart]:
    """Draw the clearance residual over time and as box plots, with the safety line."""
    moved, between = look.stacked(look.moved(flown)), look.residual_range([f for f, _ in flown])
    figure = _over_time(flown, 380, "s = d<sub>min</sub> − d<sub>T</sub> [m]")
    boxes = plot(380, legend=False)
    for flight, line in moved:
        _drawn(figure, flight.t, flight.residual, line.label, pen(line), ".3f} m")
        for at, mode in flight.modes[1:]:
            figure.add_vline(x=at, line=pen(line, dash="dot", width=1.2), annotation_text=mode)
        for begin, end, key, name in look.spans(flight):
            figure.add_vrect(
                x0=begin, x1=end, fillcolor=themed(key), opacity=0.4, line_width=0,
                annotation_text=name, annotation_position="bottom left",
            )  # fmt: skip
    for flight, line in look.moved(flown):
        add_box(boxes, line.label, flight.residual_statistics["residual_m"], line.themed)
    for flight, line in flown:
        if (foreseen := flight.predictions) is not None:
            name = f"{line.label}, foreseen"
            dotted = pen(line, dash="dot", width=1.2)
            _drawn(figure, foreseen.t, foreseen.residual, name, dotted, ".3f} m")
    for each in (figure, boxes):
        limit(each, 0.0, _ABOVE_LIMIT)
        each.update_yaxes(range=between)
    return [
        Chart(figure, "Clearance residual over time", "Over time", share=3.0),
        Chart(boxes, "Quartiles and extremes of the residual", "Quartiles and extremes"),
    ]


def clearance(flown: Flown) -> list[Chart]:
    """Draw the clearance of the centre and that of the airframe over time."""
    figure = _over_time(flown, 320, "clearance [m]")
    for flight, line in look.stacked(look.moved(flown)):
        _drawn(figure, flight.t, flight.clearance, line.label, pen(line), ".3f} m")
    for flight, line, values in look.airframes(flown):
        name, dotted = f"{line.label}, airframe", pen(line, dash="dot", width=1.4)
        _drawn(figure, flight.t, values, name, dotted, ".3f} m")
    tower = flown[0][0].tower
    limit(figure, tower.min_clearance_m, "d<sub>min</sub>, for the centre", above=False)
    figure.add_hline(y=0.0, line={"color": themed("quiet"), "width": 1.0})
    return [Chart(figure, "Clearance of the centre and of the airframe over time")]


def tracking(flown: Flown) -> list[Chart]:
    """Draw the distance to where the reference is."""
    figure = _over_time(flown, 260, "distance [m]")
    for flight, line in look.stacked(look.moved(flown)):
        _drawn(figure, flight.t, flight.tracking_error, line.label, pen(line), ".3f} m")
    figure.update_yaxes(rangemode="tozero")
    return [Chart(figure, "Distance to the reference over time")]


def wind(flown: Flown) -> list[Chart]:
    """Draw the forces of wind and gusts, for each flight that tells them."""
    blown = look.blown(flown)
    charts = []
    for flight, line in blown:
        figure = _over_time(flown, 240, "force [N]")
        for axis, values, steady in zip(
            ("x, east", "y, north", "z, up"), flight.gust_n.T, flight.wind_n.T, strict=True
        ):
            key = f"axis-{axis[0]}"
            thin = {"color": themed(key), "width": 1.1}
            thick = {"color": themed(key), "width": 3.0, "dash": "dash"}
            _drawn(figure, flight.t_wind, values, f"gust {axis}", thin, ".3f} N")
            _drawn(figure, flight.t_wind, steady, f"wind {axis}", thick, ".3f} N")
        title = line.label if len(blown) > 1 else ""
        charts.append(Chart(figure, f"Wind and gust forces, {line.label}", title))
    return charts


def margins(flown: Flown) -> list[Chart]:
    """Draw the parts of the tightening: at the last stage over time, and over the horizon."""
    charts = []
    tightened = look.tightened(flown)
    for flight, line in tightened:
        keys: dict[str, str] = {}
        last = _over_time(flown, 280, "margin [mm]", legend=False)
        horizon = plot(280, "stage i", legend=False, hovermode="x unified")
        total = flight.margins.total
        active, shown = total.any(axis=1), kept(total[:, -1])
        for name, part in look.margin_parts(flight.margins).items():
            colour, label = themed(f"margin-{name}"), look.MARGIN_LABELS[name]
            keys[label] = colour
            stack: dict[str, Any] = {"stackgroup": "parts", "fillcolor": colour}
            no_line = {"width": 0, "color": colour}
            curve(
                last, flight.margins.t[shown], 1e3 * part[shown, -1], label, no_line, ".1f} mm",
                **stack,
            )  # fmt: skip
            stages, mean = np.arange(part.shape[1]), 1e3 * part[active].mean(axis=0)
            curve(horizon, stages, mean, label, no_line, ".1f} mm", **stack)
        highest_mm = 1.05e3 * max(float(f.margins.total.max()) for f, _ in tightened)
        for figure in (last, horizon):
            figure.update_yaxes(range=(0.0, highest_mm))
        charts += [
            Chart(
                last,
                f"Margin at the last stage, {line.label}",
                f"Last stage, {line.label}",
                share=2.0,
                keys=keys,
            ),
            Chart(horizon, f"Margin over the horizon, {line.label}", "Over the horizon, mean"),
        ]
    return charts


def slack(flown: Flown) -> list[Chart]:
    """Draw the largest slack of each plan."""
    figure = _over_time(flown, 220, "slack [mm]")
    told = [(flight, line) for flight, line in look.stacked(flown) if flight.margins.t.size]
    highest_mm = 1.0
    for flight, line in told:
        largest_mm = 1e3 * flight.margins.slack.max(axis=1)
        highest_mm = max(highest_mm, float(largest_mm.max()))
        _drawn(figure, flight.margins.t, largest_mm, line.label, pen(line), ".2f} mm")
    figure.update_yaxes(range=(-0.04 * highest_mm, 1.05 * highest_mm))
    return [Chart(figure, "Largest slack of each plan over time")] if told else []


def rotors(flown: Flown) -> list[Chart]:
    """Draw the speed of every rotor, one plot a flight."""
    named = {"says": "Rotor speeds", "y": "rotor speed [Hz]", "unit": ".1f} Hz"}
    spun = [(f, line, f.t_rotors, f.rotor_speed_hz) for f, line in look.moved(flown)]
    charts = _by_rotor(flown, spun, **named)
    for chart, (flight, *_) in zip(charts, _told(spun), strict=True):
        if (vehicle := flight.vehicle) is not None:
            low, high = vehicle.min_rotor_speed_hz, vehicle.max_rotor_speed_hz
            limit(chart.figure, low, "least speed")
            limit(chart.figure, high, "greatest speed")
            chart.figure.update_yaxes(range=(low - 8.0, high + 8.0))
    return charts


def commands(flown: Flown) -> list[Chart]:
    """Draw the acceleration commanded of every rotor, one plot a flight."""
    named = {"says": "Rotor accelerations commanded", "y": "command u [Hz/s]", "unit": ".1f} Hz/s"}
    sent = [(f, line, f.t_command, f.command_hz_s) for f, line in flown]
    charts = _by_rotor(flown, sent, **named)
    for chart, (flight, *_) in zip(charts, _told(sent), strict=True):
        if (vehicle := flight.vehicle) is not None:
            bound = vehicle.max_rotor_acceleration_hz_s
            limit(chart.figure, bound, "greatest acceleration")
            limit(chart.figure, -bound, "least acceleration")
            chart.figure.update_yaxes(range=(-1.15 * bound, 1.15 * bound))
    return charts


def attitude(flown: Flown) -> list[Chart]:
    """Draw roll, pitch and the deviation of the heading from the tower."""
    charts: dict[str, Chart] = {}
    for flight, line in look.stacked(look.moved(flown)):
        for name, angle in look.angles(flight).items():
            if name not in charts:
                figure = _over_time(flown, 240, f"{name} [deg]")
                charts[name] = Chart(figure, f"{name} over time")
            _drawn(charts[name].figure, flight.t, angle, line.label, pen(line), ".2f} deg")
    return list(charts.values())


def solve_times(flown: Flown) -> list[Chart]:
    """Draw the time per controller step: over the flight, and how it is distributed."""
    timed = [(flight, line) for flight, line in flown if flight.solve_ms.size]
    if not timed:
        return []
    edges = look.solve_time_bins([flight for flight, _ in timed])
    figure = _over_time(flown, 320, "solve time [ms]")
    share = plot(320, "share of steps [%]", legend=False)
    for flight, line in timed:
        shown = kept(flight.solve_ms)
        figure.add_scatter(
            x=short(flight.t_solve[shown]), y=short(flight.solve_ms[shown]), mode="markers",
            name=line.label, marker={"size": 3, "color": line.themed, "opacity": 0.6},
            hovertemplate="%{y:.2f} ms",
        )  # fmt: skip
        counts, _ = np.histogram(flight.solve_ms, edges)
        share.add_scatter(
            x=short(np.repeat(100.0 * counts / counts.sum(), 2)),
            y=short(np.repeat(edges, 2)[1:-1]), mode="lines", fill="tozerox", name=line.label,
            line=pen(line, width=1.6), hovertemplate="%{x:.1f} % of steps near %{y:.2f} ms",
        )  # fmt: skip
    deadline = flown[0][0].deadline_ms
    highest_ms = np.nanmax([edges[-1], 1.6 * deadline])
    between = np.log10([edges[0], highest_ms]).tolist()
    for each in (figure, share):
        each.update_yaxes(type="log", tickvals=_TICKS_MS, range=between)
    if np.isfinite(deadline):
        for each in (figure, share):
            limit(each, deadline, "deadline T<sub>s</sub>")
    figure.update_layout(legend_itemsizing="constant")
    share.update_layout(hovermode="closest")
    return [
        Chart(figure, "Solve time of each step", "Over time", share=2.0),
        Chart(share, "How solve times are distributed", "Distribution"),
    ]


SECTIONS: dict[str, Callable[[Flown], list[Chart]]] = {
    draw.__name__: draw
    for draw in (
        trajectory, residual, clearance, tracking, wind, margins, slack, rotors, commands,
        attitude, solve_times,
    )
}  # fmt: skip
"""The charts of a report by section; a section without any is left out."""


def pen(line: Line, **other: Any) -> dict[str, Any]:
    """How a flight's line is drawn."""
    return {"color": line.themed, "dash": line.dash, "width": line.width_px} | other


def add_box(figure: go.Figure, name: str, box: Any, colour: str) -> None:
    """Add a box plot of ``min``, ``q1``, ``median``, ``q3`` and ``max`` [m]."""
    figure.add_box(
        x=[name], lowerfence=[box["min"]], q1=[box["q1"]], median=[box["median"]],
        q3=[box["q3"]], upperfence=[box["max"]], name=name, marker_color=colour, line_width=2,
        showlegend=False, hoverinfo="y", yhoverformat=".3f",
    )  # fmt: skip


Spun = Sequence[tuple[Flight, Line, Array, Array]]
"""Flights, each with times [s] and a column a rotor."""


def _told(spun: Spun) -> Spun:
    return [each for each in spun if each[3].size]


def _by_rotor(flown: Flown, spun: Spun, says: str, y: str, unit: str) -> list[Chart]:
    charts = []
    for _, line, t, columns in _told(spun):
        figure = _over_time(flown, 250, y, legend=False)
        keys: dict[str, str] = {}
        n_rotors = columns.shape[1]
        for rotor, values in enumerate(columns.T):
            # Opposite rotors often turn alike: the second must not hide the first.
            dash = "solid" if rotor < n_rotors / 2 else "dash"
            width = 2.4 if rotor < n_rotors / 2 else 1.4
            own: dict[str, Any] = {
                "color": themed(look.rotor_key(rotor)),
                "width": width,
                "dash": dash,
            }
            keys[f"rotor {rotor}"] = own["color"]
            _drawn(figure, t, values, f"rotor {rotor}", own, unit)
        charts.append(Chart(figure, f"{says}, {line.label}", line.label, keys=keys))
    return charts


def _over_time(flown: Flown, height_px: int, y_title: str, legend: bool = True) -> go.Figure:
    duration_s = max(flight.duration_s for flight, _ in flown)
    return over_time(height_px, y_title, duration_s, legend=legend)


def _drawn(
    figure: go.Figure, t: Array, values: Array, name: str, line: dict[str, Any], unit: str
) -> None:
    """Add a curve with as many points as can be seen."""
    shown = kept(values)
    curve(figure, t[shown], values[shown], name, line, unit)
