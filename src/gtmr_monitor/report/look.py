# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the figures on paper and in the browser have in common: colours, labels, channels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gtmr_monitor.flight import Flight, MarginHistory

Array = NDArray[np.float64]

INK = "#1a1a1a"
"""Text and axes."""
QUIET = "#6b6b6b"
"""The reference, secondary text."""
GRID = "#e3e3e3"
LIMIT = "#1a1a1a"
"""The safety line at s = 0."""
TOWER = "#c9c9c9"

# Okabe and Ito's palette: told apart with any colour vision. Blue and vermillion are its pair of
# strongest contrast, and differ in lightness too.
MODE_COLOURS = {"nominal": "#D55E00", "robust": "#0072B2", "offset_free": "#009E73"}
OTHER_COLOUR = "#CC79A7"
"""Flights that switched their mode, or do not tell it."""
GAP_COLOUR = "#bdbdbd"
"""Where the record of a flight has a gap."""
GUARD_COLOUR = "#E69F00"
"""While the guard was in charge."""
REPLAYED_COLOUR = "#56B4E9"
"""What a controller would have done that did not fly."""
Dash = Literal["solid", "dash", "dot"]
DASHES: tuple[Dash, ...] = ("solid", "dash", "dot")
"""Tells flights of the same mode apart."""

# Tol's muted palette for the nine channels of zeta, then two greys; no two neighbours in the
# stack are close in hue and lightness.
_MARGINS = {
    "mass": ("mass", "#332288"),
    "J_x": ("inertia x", "#DDCC77"),
    "J_y": ("inertia y", "#999933"),
    "J_z": ("inertia z", "#882255"),
    "thrust": ("thrust", "#44AA99"),
    "drag": ("drag", "#AA4499"),
    "w_bx": ("wind bias x", "#88CCEE"),
    "w_by": ("wind bias y", "#CC6677"),
    "w_bz": ("wind bias z", "#117733"),
    "eps_s": ("slack term ε", "#1a1a1a"),
    "gust": ("gust", "#bdbdbd"),
    "noise": ("noise", "#6b6b6b"),
    "estimate": ("estimate", "#E69F00"),
}
MARGIN_LABELS = {name: label for name, (label, _) in _MARGINS.items()}
MARGIN_COLOURS = {name: colour for name, (_, colour) in _MARGINS.items()}

_ROTOR_COLOURS = (
    "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#332288", "#999933"
)  # fmt: skip


@dataclass(frozen=True)
class Line:
    """How a flight is drawn in every figure."""

    label: str
    """Its name in legends and tables."""
    colour: str
    """By its mode."""
    dash: Dash
    """By its number among the flights of its mode."""


Flown = Sequence[tuple[Flight, Line]]
"""What every figure is drawn from."""


def lines(flights: Sequence[Flight]) -> list[Line]:
    """Give every flight its label, colour and dash; a mode flown once is its own label."""
    seen: dict[str, int] = {}
    modes = [f"{flight.mode}, replayed" if flight.replayed else flight.mode for flight in flights]
    result = []
    for flight, mode in zip(flights, modes, strict=True):
        number = seen.setdefault(mode, 0)
        seen[mode] += 1
        alone = modes.count(mode) == 1 and flight.mode != "unknown"
        label = mode if alone else f"{mode} ({flight.name})"
        colour = REPLAYED_COLOUR if flight.replayed else MODE_COLOURS.get(mode, OTHER_COLOUR)
        result.append(Line(label, colour, DASHES[number % len(DASHES)]))
    return result


def margin_parts(margins: MarginHistory) -> dict[str, Array]:
    """Split the total margin into its parts, in the order in which they are stacked.

    By channel of zeta, then ``eps_s``, ``gust`` and further ones that are not all zero,
    each [m], shape (M, N + 1).
    """
    channels = list(MARGIN_COLOURS)[:9]
    further = {n: m for n, m in margins.further.items() if n in MARGIN_COLOURS and m.any()}
    parts = {name: margins.by_channel[:, :, j] for j, name in enumerate(channels)}
    return {**parts, "eps_s": margins.eps_s, "gust": margins.alpha_g, **further}


def rotor_colour(rotor: int) -> str:
    """Colour of the line of a rotor, numbered from 0."""
    return _ROTOR_COLOURS[rotor % len(_ROTOR_COLOURS)]


def solve_time_bins(flights: Sequence[Flight]) -> Array:
    """Edges of the histogram of solve times [ms], evenly spread on a logarithmic scale."""
    times = np.concatenate([flight.solve_ms for flight in flights] or [np.ones(1)])
    times = times[times > 0.0]
    low, high = (times.min(), times.max()) if times.size else (1.0, 1.0)
    edges: Array = np.geomspace(0.95 * low, 1.05 * high, 51)
    return edges


def spans(flight: Flight) -> list[tuple[float, float, str, str]]:
    """Say what to shade over time: beginning and end [s], colour, name."""
    gaps = [(*gap, GAP_COLOUR, "gap") for gap in flight.coverage.gaps]
    return gaps + [(*span, GUARD_COLOUR, "guard") for span in flight.guarded or ()]


def tightened(flown: Flown) -> Flown:
    """Pick the flights in which the clearance constraint was tightened."""
    return [(flight, line) for flight, line in flown if flight.margins.total.any()]


def moved(flown: Flown) -> Flown:
    """Pick those that were flown, or else all: the motion of a replayed one is another's."""
    return [(flight, line) for flight, line in flown if not flight.replayed] or flown


def residual_range(flights: Sequence[Flight]) -> tuple[float, float]:
    """Limits [m] of an axis for residuals, with room for words above the safety line."""
    drawn = [flight.residual for flight in flights]
    drawn += [f.predictions.residual for f in flights if f.predictions is not None]
    low = min(float(values.min(initial=np.inf)) for values in drawn)
    high = max(0.0, *(float(values.max(initial=-np.inf)) for values in drawn))
    span = max(high - low, 0.01)
    return low - 0.05 * span, max(high + 0.05 * span, 0.1 * span)


def airframes(flown: Flown) -> list[tuple[Flight, Line, Array]]:
    """Pick the flights whose airframe is known, each with its clearance [m], shape (n,)."""
    known = [(flight, line, flight.airframe_clearance) for flight, line in moved(flown)]
    return [
        (flight, line, clearance) for flight, line, clearance in known if clearance is not None
    ]


def heights(flown: Flown) -> Array:
    """Say where the drawn tower begins and ends [m], shape (2,)."""
    z = np.concatenate([flight.p[:, 2] for flight, _ in flown])
    return np.array([z.min() - 0.15, z.max() + 0.15])


def circle(radius_m: float) -> Array:
    """X and y of a circle around the tower's axis [m], shape (2, 73)."""
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    return radius_m * np.stack([np.cos(angle), np.sin(angle)])


def cylinder(radius_m: float, z: Array) -> tuple[Array, Array, Array]:
    """x, y, z of a surface around the tower's axis between two heights [m], each (2, 73)."""
    x, y = circle(radius_m)[:, None].repeat(2, 1)
    return x, y, z[:, None].repeat(x.shape[1], 1)


def reference(flown: Flown) -> Array:
    """Follow the flights' helix for as long as they took [m], shape (600, 3)."""
    first, duration_s = flown[0][0], max(flight.duration_s for flight, _ in flown)
    return first.helix.at(np.linspace(0.0, duration_s, 600), first.tower).position


def angles(flight: Flight) -> dict[str, Array]:
    """Roll, pitch and heading error [deg], by name, each of shape (n,)."""
    columns = (*flight.eta[:, :2].T, flight.heading_error)
    return dict(zip(("roll", "pitch", "heading error"), map(np.degrees, columns), strict=True))
