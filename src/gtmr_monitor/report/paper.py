# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The figures on paper: PNG, drawn by matplotlib."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from gtmr_monitor.report import look
from gtmr_monitor.report.drawing import new_figure, save
from gtmr_monitor.report.look import Flown, Line

Array = NDArray[np.float64]

_DASHES = {"solid": "-", "dash": "--", "dot": ":"}
_LIMIT: dict[str, Any] = {"color": look.LIMIT, "linestyle": (0, (4, 2)), "linewidth": 1.2}


def trajectory(flown: Flown) -> Figure:
    """Draw the flights around the tower, in space and from above."""
    flown = look.stacked(look.by_mode(look.moved(flown)))
    figure = new_figure(9.0, 5.0)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.25, 1.0))
    space = figure.add_subplot(grid[0], projection="3d", computed_zorder=False)
    above = figure.add_subplot(grid[1])
    first = flown[0][0]
    radius, d_min = first.tower.radius_m, first.tower.min_clearance_m
    height = look.heights(flown)
    name = f"$d_\\mathrm{{min}}$ = {d_min:g} m"
    above.fill(*look.circle(radius), color=look.TOWER, label="tower")
    above.plot(*look.circle(radius + d_min), **_LIMIT | {"linewidth": 1.0}, label=name)
    reference = look.reference(flown)
    above.plot(*reference.T[:2], color=look.QUIET, linestyle=":", label="reference")

    azimuth = look.viewpoint(flown) - np.radians(_BESIDE_DEG)
    size = _box(flown, radius + d_min, height)
    seen_from = _direction(azimuth) * size
    pens: list[tuple[Array, dict[str, Any]]] = [
        (reference, {"color": look.QUIET, "linestyle": ":", "linewidth": 1.0})
    ]
    pens += [(flight.p, _pen(line)) for flight, line in flown]
    for order, (points, pen) in enumerate(pens):
        hidden = _is_behind(points, radius, height, seen_from)
        seen = np.where(hidden[:, None], np.nan, points)
        space.plot(*seen.T, **pen | {"zorder": 4.0 + 0.1 * order})
        behind = np.where(hidden[:, None], points, np.nan)
        space.plot(*behind.T, **pen | _BEHIND | {"zorder": 3.0 + 0.1 * order})
    shell = look.cylinder(radius, height)
    facing = np.cos(np.arctan2(shell[1], shell[0]) - azimuth - np.radians(50.0))
    grey = np.array(to_rgb(look.TOWER)) * (0.98 + 0.16 * facing[..., None])
    space.plot_surface(
        *shell, facecolors=grey.clip(0.0, 1.0), shade=False, linewidth=0, zorder=2,
        rcount=2, ccount=73, antialiased=False,
    )  # fmt: skip
    for z in height:
        ring = look.circle(radius + d_min)
        space.plot(*ring, np.full(ring.shape[1], z), **_LIMIT | {"linewidth": 0.8, "zorder": 2.5})
        edge = look.circle(radius)
        space.plot(*edge, np.full(edge.shape[1], z), color=look.QUIET, linewidth=0.8, zorder=2.5)
    for flight, line in flown:
        above.plot(*flight.p.T[:2], **_pen(line), label=line.label)
    space.set_proj_type("ortho")
    # A long climb would shrink a true-to-scale box to a needle: the height has its own scale.
    space.set_box_aspect((1.0, 1.0, 1.0), zoom=0.92)
    half = 0.5 * size
    middle_m = height.mean()
    space.set(
        xlabel="x, east [m]", ylabel="y, north [m]", zlabel="z [m]",
        title="In space; dotted behind the tower",
        xlim=(-half[0], half[0]), ylim=(-half[1], half[1]),
        zlim=(middle_m - half[2], middle_m + half[2]),
    )  # fmt: skip
    space.view_init(elev=_ELEVATION_DEG, azim=np.degrees(azimuth))
    for axis in (space.xaxis, space.yaxis, space.zaxis):
        axis.set_major_locator(MaxNLocator(4))
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
    above.set(xlabel="x, east [m]", ylabel="y, north [m]", title="From above", aspect="equal")
    _legend_below(figure, above, columns=6)
    return figure


_BEHIND = {"linestyle": (0, (1.0, 1.6)), "linewidth": 1.0}
"""How a path is drawn that the tower hides."""
_ELEVATION_DEG, _BESIDE_DEG = 24.0, 15.0
"""How the flight is looked at: from above, and from beside what is to be seen."""


def _direction(azimuth: float) -> Array:
    """Point to the viewer, in a box as long as wide and tall, shape (3,) [-]."""
    elevation = np.radians(_ELEVATION_DEG)
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def _box(flown: Flown, radius_m: float, height: Array) -> Array:
    """Lengths of the edges of what is drawn [m], shape (3,)."""
    reach_m = max(radius_m, *(np.abs(flight.p[:, :2]).max() for flight, _ in flown))
    return np.array([2.1 * reach_m, 2.1 * reach_m, np.ptp(height)])


def _is_behind(
    points: Array, radius_m: float, height: Array, seen_from: Array
) -> NDArray[np.bool_]:
    """Say which points, shape (n, 3), the tower hides from a viewer far away in that direction.

    It does where the line of sight meets its wall on the way, or its top.
    """
    level = seen_from[:2]
    # |points + s level| = radius, of the two crossings with the wall that nearer to the viewer.
    a, b = level @ level, points[:, :2] @ level
    c = (points[:, :2] ** 2).sum(axis=1) - radius_m**2
    root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
    enters, leaves = (-b - root) / a, (-b + root) / a
    low, high = height
    z_enters, z_leaves = (points[:, 2] + s * seen_from[2] for s in (enters, leaves))
    passes = (np.minimum(z_enters, z_leaves) < high) & (np.maximum(z_enters, z_leaves) > low)
    hidden: NDArray[np.bool_] = (b**2 > a * c) & (enters > 0.0) & passes
    return hidden


def residual(flown: Flown) -> Figure:
    """Draw the clearance residual over time and as box plots, with the safety line."""
    figure = new_figure(9.0, 4.0)
    over_time, box = figure.subplots(1, 2, width_ratios=(3.4, 1.0), sharey=True)
    moved = look.moved(flown)
    for flight, line in moved:
        over_time.plot(flight.t, flight.residual, **_pen(line), label=line.label)
        for begin, end, key, name in look.spans(flight):
            over_time.axvspan(begin, end, color=look.LIGHT[key], alpha=0.4, linewidth=0)
            over_time.annotate(name, (begin, 0.02), xycoords=("data", "axes fraction"), fontsize=8)
        for at, mode in flight.modes[1:]:
            over_time.axvline(at, color=line.colour, linestyle=":", linewidth=1.0)
            over_time.annotate(
                f" {mode}", (at, 1.0), xycoords=("data", "axes fraction"), va="top", fontsize=8
            )
    for flight, line in flown:
        if (plans := flight.predictions) is not None:
            pen = _pen(line) | {"linestyle": ":", "linewidth": 0.9}
            over_time.plot(plans.t, plans.residual, **pen, label=f"{line.label}, foreseen")
    boxes = box.boxplot(
        [flight.residual for flight, _ in moved], whis=(0.0, 100.0), widths=0.5, patch_artist=True,
        medianprops={"color": look.INK, "linewidth": 1.4},
    )  # fmt: skip
    for patch, (_, line) in zip(boxes["boxes"], moved, strict=True):
        patch.set(facecolor=line.colour, alpha=0.55, edgecolor=line.colour)
    box.set_xticks(range(1, len(moved) + 1), [line.label.replace(" ", "\n") for _, line in moved])
    box.grid(axis="x", visible=False)
    box.set_title("Quartiles, extremes")
    for axes in (over_time, box):
        axes.axhline(0.0, **_LIMIT)
    over_time.annotate(
        "violated above 0", (0.005, 0.0), (0.0, 3.0), xycoords=("axes fraction", "data"),
        textcoords="offset points", va="bottom", fontsize=8, color=look.LIMIT,
    )  # fmt: skip
    over_time.set_ylim(look.residual_range([flight for flight, _ in flown]))
    over_time.set(
        xlabel="time [s]", ylabel=r"$s = d_\mathrm{min} - d_T$ [m]", title="Clearance residual"
    )
    over_time.margins(x=0.0)
    _legend_below(figure, over_time)
    return figure


def clearance(flown: Flown) -> Figure:
    """Draw the clearance of the centre and that of the airframe over time."""
    figure = new_figure(9.0, 3.6)
    axes = figure.subplots()
    for flight, line in look.moved(flown):
        axes.plot(flight.t, flight.clearance, **_pen(line), label=line.label)
    for flight, line, values in look.airframes(flown):
        pen = _pen(line) | {"linestyle": ":", "linewidth": 0.9}
        axes.plot(flight.t, values, **pen, label=f"{line.label}, airframe")
    axes.axhline(flown[0][0].tower.min_clearance_m, **_LIMIT)
    axes.axhline(0.0, color=look.QUIET, linewidth=0.6, zorder=0)
    axes.set(xlabel="time [s]", ylabel="clearance [m]", title="Clearance of centre and airframe")
    axes.margins(x=0.0)
    _legend_below(figure, axes)
    return figure


def margins(flown: Flown) -> Figure:
    """Draw the parts of the tightening: at the last stage over time, and over the horizon."""
    tightened = look.tightened(flown)
    figure = new_figure(9.0, 3.3 * max(1, len(tightened)) + 0.7)
    if not tightened:
        axes = figure.subplots()
        axes.text(0.5, 0.5, "no tightening was recorded", ha="center", va="center")
        axes.set_axis_off()
        return figure
    rows = figure.subplots(len(tightened), 2, squeeze=False, width_ratios=(1.6, 1.0), sharey="row")
    for (flight, line), (over_time, horizon) in zip(tightened, rows, strict=True):
        parts = look.margin_parts(flight.margins)
        labels = [look.MARGIN_LABELS[name] for name in parts]
        colours = [look.MARGIN_COLOURS[name] for name in parts]
        last = [1e3 * part[:, -1] for part in parts.values()]
        over_time.stackplot(flight.margins.t, last, colors=colours, labels=labels, linewidth=0)
        stages = np.arange(flight.margins.total.shape[1])
        mean = [1e3 * part[flight.margins.total.any(axis=1)].mean(axis=0)
                for part in parts.values()]  # fmt: skip
        horizon.stackplot(stages, mean, colors=colours, linewidth=0)
        over_time.set(xlabel="time [s]", ylabel="margin [mm]", title=f"Last stage, {line.label}")
        horizon.set(xlabel="stage i", title="Over the horizon, mean of the flight")
        over_time.margins(x=0.0)
        horizon.margins(x=0.0)
        horizon.xaxis.set_major_locator(MaxNLocator(integer=True))
    _legend_below(figure, rows[0][0], columns=6)
    return figure


def solve_times(flown: Flown) -> Figure:
    """Draw the time per controller step: over the flight, and how it is distributed."""
    figure = new_figure(9.0, 3.8)
    over_time, share = figure.subplots(1, 2, width_ratios=(2.0, 1.0), sharey=True)
    timed = [(flight, line) for flight, line in flown if flight.solve_ms.size]
    edges = look.solve_time_bins([flight for flight, _ in timed])
    for flight, line in timed:
        over_time.plot(
            flight.t_solve, flight.solve_ms, ".", markersize=2.5, color=line.colour, alpha=0.45
        )
        share.hist(
            flight.solve_ms, edges, orientation="horizontal", histtype="stepfilled",
            facecolor=to_rgba(line.colour, 0.3), edgecolor=line.colour, label=line.label,
            linestyle=_DASHES[line.dash], linewidth=1.2,
        )  # fmt: skip
    deadline = flown[0][0].deadline_ms
    if np.isfinite(deadline):
        for axes in (over_time, share):
            axes.axhline(deadline, **_LIMIT)
        share.annotate(
            "deadline $T_s$", (1.0, deadline), (0.0, 3.0), xycoords=("axes fraction", "data"),
            textcoords="offset points", ha="right", va="bottom", fontsize=8,
        )  # fmt: skip
    over_time.set_yscale("log")
    over_time.yaxis.set_major_formatter("{x:g}")
    over_time.set(xlabel="time [s]", ylabel="solve time [ms]", title="Time per controller step")
    over_time.margins(x=0.0)
    share.set(xlabel="steps", title="Distribution")
    if timed:
        _legend_below(figure, share)
    return figure


def rotors(flown: Flown) -> Figure:
    """Draw the speed of every rotor, one panel per flight."""
    flown = look.moved(flown)
    figure = new_figure(9.0, 2.4 * len(flown) + 0.6)
    panels = figure.subplots(len(flown), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
    for (flight, line), axes in zip(flown, panels, strict=True):
        for rotor, speed in enumerate(flight.rotor_speed_hz.T):
            axes.plot(
                flight.t_rotors, speed, linewidth=1.1, label=f"rotor {rotor}",
                color=look.LIGHT[look.rotor_key(rotor)],
                # Opposite rotors often turn alike: the second must not hide the first.
                linestyle="-" if rotor < flight.rotor_speed_hz.shape[1] / 2 else (0, (3, 2)),
            )  # fmt: skip
        axes.set(ylabel="rotor speed [Hz]", title=f"Rotor speeds, {line.label}")
        axes.margins(x=0.0)
    panels[-1].set_xlabel("time [s]")
    _legend_below(figure, panels[0], columns=8)
    return figure


def attitude(flown: Flown) -> Figure:
    """Draw roll, pitch and the deviation of the heading from the tower."""
    flown = look.moved(flown)
    figure = new_figure(9.0, 5.6)
    panels = figure.subplots(3, 1, sharex=True)
    for flight, line in flown:
        for axes, (name, angle) in zip(panels, look.angles(flight).items(), strict=True):
            axes.plot(flight.t, angle, **_pen(line), label=line.label)
            axes.set_ylabel(f"{name} [deg]")
    for axes in panels:
        axes.margins(x=0.0)
        axes.axhline(0.0, color=look.QUIET, linewidth=0.6, zorder=0)
    panels[0].set_title("Attitude; heading against the bearing to the tower's axis")
    panels[-1].set_xlabel("time [s]")
    figure.align_ylabels(panels)
    _legend_below(figure, panels[0])
    return figure


FIGURES: dict[str, Callable[[Flown], Figure]] = {
    draw.__name__: draw
    for draw in (trajectory, residual, clearance, margins, solve_times, rotors, attitude)
}
"""The figures of a report by name."""


def write_figures(flown: Flown, prefix: Path) -> list[Path]:
    """Draw every figure into a PNG file: the prefix, then the figure's name."""
    files = []
    for name, draw in FIGURES.items():
        stem = prefix.with_name(f"{prefix.name}-{name.replace('_', '-')}")
        files += save(partial(draw, flown), stem, ("png",))
    return files


def _pen(line: Line) -> dict[str, Any]:
    return {
        "color": line.colour,
        "linestyle": _DASHES[line.dash],
        "linewidth": 0.7 * line.width_px,
        "zorder": 3.0 - 0.1 * line.width_px,
    }


def _legend_below(figure: Figure, axes: Axes, columns: int = 5) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(columns, len(labels)))
