# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The report of one or more flights: one self-contained HTML file, and the figures as PNG."""

import math
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Literal

import numpy as np

from gtmr_model import CHANNELS
from gtmr_monitor.bag.format import BagError
from gtmr_monitor.flight import Flight
from gtmr_monitor.report import look
from gtmr_monitor.report.charts import charts_html
from gtmr_monitor.report.curves import SECTIONS
from gtmr_monitor.report.decimation import MOST_POINTS
from gtmr_monitor.report.html import Card, cards, page, signed, table, verdict
from gtmr_monitor.report.look import Flown, Line, lines
from gtmr_monitor.report.paper import write_figures

CAPTIONS = {
    "trajectory": (
        "Trajectory",
        "The flights around the tower, with the helix that was to be followed and the shell of "
        "least admissible clearance. A path behind the tower shines through it. Drag to turn, "
        "scroll to zoom.",
    ),
    "residual": (
        "Clearance residual",
        "s = d<sub>min</sub> − d<sub>T</sub> at every odometry message; below the dashed line "
        "the clearance constraint holds. Boxes show quartiles, whiskers the extremes. Where a "
        "flight was replayed, dotted lines show what each plan foresaw of the instant at which "
        "it ends.",
    ),
    "clearance": (
        "Clearance of centre and airframe",
        "Distance to the tower's surface: of the vehicle's centre, d<sub>T</sub>, and dotted of "
        "its airframe, the nearest rotor disc, which is inside the tower below 0. The constraint "
        "of the paper is on the centre.",
    ),
    "tracking": (
        "Tracking error",
        "Distance of the vehicle's centre to where the reference is at that time. A robust "
        "controller keeps away from the reference on purpose where its margins ask for it.",
    ),
    "wind": (
        "Wind and gusts",
        "Forces on the vehicle: dashed what the wind does without gusts, thin the gust force "
        "w<sub>g</sub>. Flights that met the same weather share a plot.",
    ),
    "margins": (
        "Tightening margins",
        "By how much the clearance constraint is tightened, and for which uncertainty: the terms "
        "of α<sub>p</sub> by channel, its constant term, and the gust margin α<sub>g</sub>.",
    ),
    "slack": (
        "Slack",
        "By how much a plan violates the tightened clearance at most: zero where it can be kept.",
    ),
    "rotors": (
        "Rotor speeds",
        "Speed of each rotor as the simulator reported it, between its limits.",
    ),
    "commands": (
        "Commands",
        "Acceleration of each rotor that the controller commanded, between its limits.",
    ),
    "attitude": (
        "Attitude",
        "Roll, pitch, and the heading error: yaw minus the bearing to the tower's axis.",
    ),
    "solve_times": (
        "Solve times",
        "Preparation and feedback of each controller step, wall time, on a logarithmic scale.",
    ),
}
"""Title and explanation of every section."""

_MOST_SPANS = 10
"""So many times at which the guard was in charge are listed."""

Value = Callable[[Flight], str | None]
"""A cell in HTML; None where that was not recorded."""
Row = tuple[str, Value]


def write_report(flights: Sequence[Flight], out_html: str | Path) -> list[Path]:
    """Write a report on flights, compared side by side; the first gives tower and reference.

    Figures go beside the HTML file as ``<stem>-<figure>.png``. All are written over, and returned,
    the HTML file first. Raises ValueError if there is no flight; BagError if the files cannot be
    written.
    """
    if not flights:
        raise ValueError("a report needs at least one flight")
    out = Path(out_html)
    flown = list(zip(flights, lines(flights), strict=True))
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(_page(flown), encoding="utf-8")
        figures = write_figures(flown, out.with_suffix(""))
    except OSError as error:
        raise BagError(f"{out}: cannot write the report: {error.strerror}") from None
    return [out, *figures]


def _page(flown: Flown) -> str:
    labels = [line.label for _, line in flown]
    modes = " and ".join(filter(None, (", ".join(labels[:-1]), labels[-1])))
    trajectory, *sections = (_section(name, flown) for name in SECTIONS)
    foreseen = any(flight.predictions is not None for flight, _ in flown)
    warnings = "".join(
        f'<p class="warning">{escape(line.label)}: the bag has no end, because its recorder was '
        "killed; what it had written is shown.</p>"
        for flight, line in flown
        if flight.truncated
    )
    warnings += "".join(
        f'<p class="warning">{escape(line.label)}: the record is not whole, it covers '
        f"{escape(str(flight.coverage))}. What is said of the flight is true of what is covered."
        "</p>"
        for flight, line in flown
        if not flight.coverage.whole
    )
    warnings += "".join(
        f'<p class="warning">{escape(line.label)}: {escape(note)}.</p>'
        for flight, line in flown
        for note in flight.notes
    )
    warnings += "".join(
        f'<p class="warning">{escape(line.label)}: the guard was in charge, not the controller, '
        f"for {flight.guard_time_s:.2f} s: {_spans(flight.guarded)}.</p>"
        for flight, line in flown
        if flight.guarded and not flight.replayed
    )
    warnings += "".join(
        f"<p>{escape(line.label)}: this controller did not fly. It was fed the recorded states "
        "again: motion and residual are the recorded ones; margins, slack, solve times and what "
        "its plans foresee are its own.</p>"
        for flight, line in flown
        if flight.replayed
    )
    warnings += "".join(
        f"<p>{escape(line.label)}: clearance and motion are of the measured odometry, noise "
        "included: there was no ground_truth.</p>"
        for flight, line in flown
        if flight.clearance_from == "odom"
    )
    body = f"""{cards(_card(flight, line) for flight, line in look.moved(flown))}
{warnings}
{trajectory}
<div class="tables">
<section><h2>Summary</h2>
{_table(flown, (*_SUMMARY, *_COMPARISON) if foreseen else _SUMMARY)}</section>
<section><h2>Flight conditions</h2>
{_table(flown, _CONDITIONS)}</section>
</div>
{"".join(sections)}{_thinned(flown)}"""
    return page(f"Tower inspection: {modes}", body, charts=True)


def _card(flight: Flight, line: Line) -> Card:
    """Say first whether the clearance was kept, and by how much."""
    statistics = flight.residual_statistics
    kept = not statistics["violated"]
    covered = "" if flight.coverage.whole else ", in what is recorded"
    by_mm = 1e3 * abs(statistics["residual_m"]["max"])
    return Card(
        line.label,
        f"{statistics['min_clearance_m']:.3f} m",
        f"least clearance, {by_mm:.0f} mm {'above' if kept else 'below'} d<sub>min</sub><br>"
        + verdict(kept, f"{'kept' if kept else 'violated'}{covered}"),
        line.key,
    )


def _thinned(flown: Flown) -> str:
    """Say so if curves are drawn from fewer samples than there are."""
    most = max(flight.t.size for flight, _ in flown)
    if most <= MOST_POINTS:
        return ""
    return (
        f'<p class="note">Curves of more than {MOST_POINTS} samples (up to {most} here) are '
        "thinned out: of each short span of time the smallest and the largest are drawn. Numbers "
        "are of all samples.</p>"
    )


def _section(name: str, flown: Flown) -> str:
    charts = SECTIONS[name](flown)
    if not charts:
        return ""
    title, caption = CAPTIONS[name]
    return f"<section><h2>{title}</h2>\n<p>{caption}</p>\n{charts_html(name, charts)}</section>\n"


def _table(flown: Flown, rows: Sequence[Row]) -> str:
    heads = [(line.label, line.themed) for _, line in flown]
    cells = [(name, [value(flight) for flight, _ in flown]) for name, value in rows]
    told = [(name, ["not recorded" if c is None else c for c in row]) for name, row in cells]
    return table(heads, told)


def _spans(spans: Sequence[tuple[float, float]]) -> str:
    shown = [f"{begin:.2f} to {end:.2f} s" for begin, end in spans[:_MOST_SPANS]]
    more = len(spans) - len(shown)
    return ", ".join(shown) + (f", and {more} times more" if more else "")


def _violated(flight: Flight) -> str:
    share = 100.0 * float((flight.residual > 0.0).mean())
    limits = "" if flight.coverage.whole else ", in what is covered"
    if not flight.residual_statistics["violated"]:
        return f"no{limits}"
    return f"{verdict(False, 'yes')}, {share:.1f} % of samples{limits}"


def _solve(key: Literal["median", "p99", "max"]) -> Value:
    return lambda f: f"{f.solve_statistics[key]:.2f}" if f.solve_statistics else None


def _quartile(key: Literal["min", "q1", "median", "q3", "max"]) -> Value:
    return lambda flight: signed(flight.residual_statistics["residual_m"][key])


def _airframe(flight: Flight) -> str | None:
    clearance = flight.airframe_clearance
    return None if clearance is None else signed(float(clearance.min()))


def _softened(flight: Flight) -> str | None:
    steps = flight.margins.t.size
    used = int((flight.margins.slack.max(axis=1, initial=0.0) > 1e-6).sum())
    return f"{used} of {steps}" if steps else None


def _foreseen(flight: Flight) -> str | None:
    if flight.predictions is None or not flight.predictions.t.size:
        return None
    return signed(float(flight.predictions.residual.max()))


def _channel(index: int, unit: str, scale: float, places: int) -> Value:
    def value(flight: Flight) -> str | None:
        if flight.zeta is None:
            return None
        return f"{scale * flight.zeta[index]:.{places}f} {unit}".replace("-", "−")

    return value


_SUMMARY: tuple[Row, ...] = (
    (
        "minimum clearance [m]",
        lambda f: f"<strong>{f.residual_statistics['min_clearance_m']:.3f}</strong>",
    ),
    ("minimum clearance of the airframe [m]", _airframe),
    ("clearance violated", _violated),
    ("residual s, maximum [m]", _quartile("max")),
    ("upper quartile [m]", _quartile("q3")),
    ("median [m]", _quartile("median")),
    ("lower quartile [m]", _quartile("q1")),
    ("minimum [m]", _quartile("min")),
    ("tracking error, RMS [m]", lambda f: f"{np.sqrt(np.mean(f.tracking_error**2)):.3f}"),
    ("maximum [m]", lambda f: f"{f.tracking_error.max():.3f}"),
    ("samples", lambda f: str(f.residual.size)),
    (
        "guard in charge [s]",
        lambda f: None if f.guard_time_s is None else f"{f.guard_time_s:.2f}",
    ),
    ("record covers", lambda f: escape(str(f.coverage))),
    ("solve time, median [ms]", _solve("median")),
    ("99th percentile [ms]", _solve("p99")),
    ("maximum [ms]", _solve("max")),
    (
        "deadline misses",
        lambda f: None if (n := f.deadline_misses) is None else f"{n} of {f.solve_ms.size}",
    ),
    ("steps with slack", _softened),
    (
        "largest slack [mm]",
        lambda f: f"{1e3 * f.margins.slack.max():.2f}" if f.margins.slack.size else None,
    ),
)
_COMPARISON: tuple[Row, ...] = (
    ("residual foreseen at the end of plans, maximum [m]", _foreseen),
    (
        "largest margin [m]",
        lambda f: f"{f.margins.total.max():.3f}" if f.margins.t.size else None,
    ),
)
_CONDITIONS: tuple[Row, ...] = (
    ("duration", lambda f: f"{f.duration_s:.1f} s"),
    ("tower radius", lambda f: f"{f.tower.radius_m:g} m"),
    ("least clearance d<sub>min</sub>", lambda f: f"{f.tower.min_clearance_m:g} m"),
    ("reference clearance", lambda f: f.helix.clearance_text(f.duration_s, f.tower)),
    ("sampling time", lambda f: None if math.isnan(f.deadline_ms) else f"{f.deadline_ms:g} ms"),
    *((f"true mismatch, {name}", _channel(j, "%", 100, 1)) for j, name in enumerate(CHANNELS[:6])),
    *(
        (f"true wind bias, {axis}", _channel(j, "N", 1, 2))
        for j, axis in ((6, "x, east"), (7, "y, north"), (8, "z, up"))
    ),
    ("gusts", lambda f: None if f.gust is None else escape(str(f.gust))),
    ("seed", lambda f: None if f.seed is None else str(f.seed)),
    ("file", lambda f: f"<code>{escape(f.source.name)}</code>" if f.source.name else None),
)
