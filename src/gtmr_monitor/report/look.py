# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the figures on paper and in the browser have in common: colours, labels, channels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gtmr_monitor.flight import Flight, MarginHistory

Array = NDArray[np.float64]

# Light theme, dark theme. Figures on paper take the first; a page takes that which the browser
# asks for. Modes, guard, replayed and others are Okabe and Ito's palette, told apart with any
# colour vision: blue and vermillion are its pair of strongest contrast, and differ in lightness
# too. Parts of margins are Tol's muted palette, in which no two neighbours of the stack are close
# in hue and lightness, then greys. The dark ones have at least 3:1 on their page.
PALETTE: dict[str, tuple[str, str]] = {
    "page": ("#ffffff", "#15181b"),
    "raised": ("#f5f6f7", "#1f2428"),
    "ink": ("#1a1a1a", "#e9e7e4"),
    "quiet": ("#5c5c5c", "#a8adb2"),
    "grid": ("#e3e3e3", "#30363b"),
    "limit": ("#1a1a1a", "#e9e7e4"),
    "tower": ("#c9c9c9", "#6a7076"),
    "good": ("#00694d", "#4fd0a5"),
    "bad": ("#a33c00", "#ff9d66"),
    "nominal": ("#D55E00", "#f0803c"),
    "robust": ("#0072B2", "#4aa3e6"),
    "offset_free": ("#009E73", "#2fc297"),
    "other": ("#CC79A7", "#d98bb6"),
    "gap": ("#bdbdbd", "#5a5f64"),
    "guard": ("#E69F00", "#e6a91a"),
    "replayed": ("#56B4E9", "#7fc8f0"),
    "paper": ("#8c8c8c", "#9aa0a6"),
    "margin-mass": ("#332288", "#8f83e0"),
    "margin-J_x": ("#DDCC77", "#ddcc77"),
    "margin-J_y": ("#999933", "#a9a944"),
    "margin-J_z": ("#882255", "#c4568c"),
    "margin-thrust": ("#44AA99", "#44aa99"),
    "margin-drag": ("#AA4499", "#cf6fbf"),
    "margin-w_bx": ("#88CCEE", "#88ccee"),
    "margin-w_by": ("#CC6677", "#d97a8a"),
    "margin-w_bz": ("#117733", "#3fa65f"),
    "margin-eps_s": ("#1a1a1a", "#e9e7e4"),
    "margin-parametric": ("#332288", "#8f83e0"),
    "margin-gust": ("#bdbdbd", "#bdbdbd"),
    "margin-noise": ("#6b6b6b", "#7d8388"),
    "margin-estimate": ("#E69F00", "#e6a91a"),
    "axis-x": ("#0072B2", "#4aa3e6"),
    "axis-y": ("#B36B00", "#e6a91a"),
    "axis-z": ("#00805d", "#2fc297"),
    "rotor-0": ("#0072B2", "#4aa3e6"),
    "rotor-1": ("#E69F00", "#e6a91a"),
    "rotor-2": ("#009E73", "#2fc297"),
    "rotor-3": ("#CC79A7", "#d98bb6"),
    "rotor-4": ("#56B4E9", "#9ad4f5"),
    "rotor-5": ("#D55E00", "#f0803c"),
    "rotor-6": ("#332288", "#8f83e0"),
    "rotor-7": ("#999933", "#b9b94f"),
    "rival-lqr": ("#8a6d00", "#d9b93b"),
    "rival-pid": ("#a0522d", "#d9926b"),
    "rival-indi": ("#6b7a00", "#b3c23a"),
    "rival-fixed_margin": ("#b8336a", "#ee7fa8"),
    "rival-robust_gradient": ("#3a49b8", "#8b97f5"),
    "rival-ellipsoid": ("#6a3d9a", "#b58be0"),
    "rival-ellipsoid_feedback": ("#a44fc0", "#d9a6f2"),
    "rival-tube": ("#00798c", "#39b8cc"),
    "rival-scenario_tree": ("#7f4f24", "#c49a6c"),
    "rival-oracle": ("#1a1a1a", "#e9e7e4"),
}
"""Colours by name, on a light page and on a dark one; pages know them as CSS variables."""

LIGHT = {name: light for name, (light, _) in PALETTE.items()}
INK, QUIET, GRID, LIMIT, TOWER = (
    LIGHT[name] for name in ("ink", "quiet", "grid", "limit", "tower")
)
"""Text and axes, secondary text and the reference, lines of a grid, safety line, tower."""
MODES = ("nominal", "robust", "offset_free")
MODE_COLOURS = {name: LIGHT[name] for name in MODES}
OTHER_COLOUR = LIGHT["other"]
"""Flights that switched their mode, or do not tell it."""
GAP_COLOUR = LIGHT["gap"]
"""Where the record of a flight has a gap."""
GUARD_COLOUR = LIGHT["guard"]
"""While the guard was in charge."""
REPLAYED_COLOUR = LIGHT["replayed"]
"""What a controller would have done that did not fly."""
Dash = Literal["solid", "dash", "dot"]
DASHES: tuple[Dash, ...] = ("solid", "dash", "dot")
"""Tells flights of the same mode apart."""
_WIDTHS_PX = {"nominal": 4.2, "robust": 1.9, "offset_free": 1.2}
"""Where flights coincide, the thinner line lies on the thicker one, and both are seen."""

MARGIN_LABELS = {
    "mass": "mass",
    "J_x": "inertia x",
    "J_y": "inertia y",
    "J_z": "inertia z",
    "thrust": "thrust",
    "drag": "drag",
    "w_bx": "wind bias x",
    "w_by": "wind bias y",
    "w_bz": "wind bias z",
    "eps_s": "slack term ε",
    "gust": "gust",
    "noise": "noise",
    "estimate": "estimate",
    "parametric": "parametric α_p",
}
"""What parts of a margin are called, in the order in which they are stacked."""
MARGIN_COLOURS = {name: LIGHT[f"margin-{name}"] for name in MARGIN_LABELS}
_N_ROTOR_COLOURS = sum(name.startswith("rotor-") for name in PALETTE)


def themed(name: str) -> str:
    """Colour of the palette as a page has it, in either theme: a CSS variable."""
    if name not in PALETTE:
        raise KeyError(f"colour {name!r}: there is {', '.join(PALETTE)}")
    return f"var(--{name})"


def mode_key(mode: str) -> str:
    """Name the colour of a mode, or of a controller of one's own, in the palette."""
    return mode if mode in MODES else "other"


def controller_key(name: str) -> str:
    """Name the colour of a controller of the arena in the palette."""
    key = f"rival-{name}"
    return key if key in PALETTE else mode_key(name)


@dataclass(frozen=True)
class Line:
    """How a flight is drawn in every figure."""

    label: str
    """Its name in legends and tables."""
    key: str
    """Its colour's name in the palette, by its mode."""
    dash: Dash
    """By its number among the flights of its mode."""
    width_px: float
    """By its mode."""

    @property
    def colour(self) -> str:
        """Its colour on paper."""
        return LIGHT[self.key]

    @property
    def themed(self) -> str:
        """Its colour on a page."""
        return themed(self.key)


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
        key = "replayed" if flight.replayed else mode_key(mode)
        width_px = _WIDTHS_PX.get(key, 1.9)
        result.append(Line(label, key, DASHES[number % len(DASHES)], width_px))
    return result


def by_mode(flown: Flown) -> Flown:
    """Cut flights where their mode was switched, each piece in the colour of its mode.

    For paths in space alone: a piece has times, position and attitude of its own, no more.
    """
    pieces = []
    for flight, line in flown:
        if len(flight.modes) < 2:
            pieces.append((flight, line))
            continue
        ends = [*(begin for begin, _ in flight.modes[1:]), np.inf]
        for (begin, mode), end in zip(flight.modes, ends, strict=True):
            # Pieces share a sample, so that there is no gap between them.
            first = max(int(np.searchsorted(flight.t, begin, "right")) - 1, 0)
            here = slice(first, int(np.searchsorted(flight.t, end, "right")))
            piece = replace(
                flight, t=flight.t[here], p=flight.p[here], eta=flight.eta[here],
                modes=((begin, mode),),
            )  # fmt: skip
            if len(piece.t) < 2:
                continue
            label = mode if line.label == flight.mode else f"{line.label}: {mode}"
            key, width_px = mode_key(mode), _WIDTHS_PX.get(mode_key(mode), line.width_px)
            pieces.append((piece, replace(line, label=label, key=key, width_px=width_px)))
    return pieces


def stacked(flown: Flown) -> Flown:
    """Order flights so that the thinner lines are drawn last, on top of the thicker ones."""
    return sorted(flown, key=lambda each: -each[1].width_px)


def margin_parts(margins: MarginHistory) -> dict[str, Array]:
    """Split the total margin into its parts, in the order in which they are stacked.

    By channel of zeta, or ``parametric`` where these are not known, then ``eps_s``, ``gust``
    and further ones that are not all zero, each [m], shape (M, N + 1).
    """
    further = {n: m for n, m in margins.further.items() if n in MARGIN_COLOURS and m.any()}
    if margins.parametric is not None:
        return {"parametric": margins.parametric, "gust": margins.alpha_g, **further}
    channels = list(MARGIN_COLOURS)[:9]
    parts = {name: margins.by_channel[:, :, j] for j, name in enumerate(channels)}
    return {**parts, "eps_s": margins.eps_s, "gust": margins.alpha_g, **further}


def rotor_key(rotor: int) -> str:
    """Name the colour of a rotor's line in the palette; rotors are numbered from 0."""
    return f"rotor-{rotor % _N_ROTOR_COLOURS}"


def solve_time_bins(flights: Sequence[Flight]) -> Array:
    """Edges of the histogram of solve times [ms], evenly spread on a logarithmic scale."""
    times = np.concatenate([flight.solve_ms for flight in flights] or [np.ones(1)])
    times = times[times > 0.0]
    low, high = (times.min(), times.max()) if times.size else (1.0, 1.0)
    edges: Array = np.geomspace(0.95 * low, 1.05 * high, 51)
    return edges


def spans(flight: Flight) -> list[tuple[float, float, str, str]]:
    """Say what to shade over time: beginning and end [s], colour in the palette, name."""
    gaps = [(*gap, "gap", "gap") for gap in flight.coverage.gaps]
    return gaps + [(*span, "guard", "guard") for span in flight.guarded or ()]


def tightened(flown: Flown) -> Flown:
    """Pick the flights in which the clearance constraint was tightened."""
    return [(flight, line) for flight, line in flown if flight.margins.total.any()]


def blown(flown: Flown) -> Flown:
    """Pick the flights that tell wind and gusts, each weather once: all may meet the same."""
    different: list[tuple[Flight, Line]] = []
    for flight, line in moved(flown):
        known = any(
            np.array_equal(flight.gust_n, other.gust_n)
            and np.array_equal(flight.wind_n, other.wind_n)
            for other, _ in different
        )
        if flight.t_wind.size and not known:
            different.append((flight, line))
    return different


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
    """Say where the drawn tower begins and ends [m], shape (2,).

    Tall enough for a tower also where a flight is short.
    """
    z = np.concatenate([flight.p[:, 2] for flight, _ in flown])
    half = max(0.5 * np.ptp(z) + 0.3, flown[0][0].tower.radius_m)
    middle = 0.5 * (z.min() + z.max())
    return np.array([middle - half, middle + half])


def viewpoint(flown: Flown) -> float:
    """Azimuth of a viewer in front of what is to be seen [rad], seen from the tower's axis.

    Of flights that go not all the way around it is their middle, of others the place of the least
    clearance.
    """
    p = np.concatenate([flight.p for flight, _ in flown])
    azimuth = np.arctan2(p[:, 1], p[:, 0])
    mean = np.exp(1j * azimuth).mean()
    if abs(mean) > 0.25:
        return float(np.angle(mean))
    return float(azimuth[np.concatenate([flight.clearance for flight, _ in flown]).argmin()])


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
