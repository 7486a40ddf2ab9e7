# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A recorded flight: what reports are made from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_model import ReferencePath, Tower, Vehicle, airframe_clearance
from gtmr_monitor.coverage import Coverage
from gtmr_monitor.residual import (
    ResidualStatistics,
    SolveStatistics,
    residual_statistics,
    solve_statistics,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MarginHistory:
    """What tightened the clearance constraint, eq. (14), at M controller steps."""

    t: Array
    """When [s], shape (M,)."""
    by_channel: Array
    """The terms |Pi_y,i,j| w_bar_j of alpha_p, eq. (12) [m], shape (M, N + 1, 9)."""
    eps_s: Array
    """The constant term of eq. (12) [m], shape (M, N + 1)."""
    alpha_g: Array
    """Gust margin, eq. (13) [m], shape (M, N + 1)."""
    slack: Array
    """By how much the plan violates the tightened clearance [m], shape (M, N + 1)."""
    further: Mapping[str, Array] = field(default_factory=dict)
    """Further margins by name, such as ``noise`` [m], shape (M, N + 1) each."""
    parametric: Array | None = None
    """alpha_p as a whole [m], shape (M, N + 1), where its terms are not known; these are then
    zero. None where they are known."""

    @property
    def alpha_p(self) -> Array:
        """Parametric margin, eq. (12), eps_s included [m], shape (M, N + 1)."""
        if self.parametric is not None:
            return self.parametric
        total: Array = self.by_channel.sum(axis=2) + self.eps_s
        return total

    @property
    def total(self) -> Array:
        """alpha_p + alpha_g, and further margins [m], shape (M, N + 1)."""
        total: Array = self.alpha_p + self.alpha_g + sum(self.further.values())
        return total


@dataclass(frozen=True)
class Predictions:
    """What the plans of M controller steps foresee of the clearance."""

    t: Array
    """When they end [s], shape (M,)."""
    residual: Array
    """s = d_min - d_T at the end of each plan [m], shape (M,)."""


@dataclass(frozen=True)
class Flight:
    """One flight, read from a bag or flown in this process; times count from its first odometry.

    Position and attitude are the truth, where that was recorded; else the measured odometry.
    """

    name: str
    """What to call it."""
    source: Path
    """The bag, or the file that the rows of a flight came from."""
    t: Array
    """Times of position and attitude [s], shape (n,)."""
    p: Array
    """Position, world ENU [m], shape (n, 3)."""
    eta: Array
    """Roll, pitch, yaw of body FLU in world ENU [rad], shape (n, 3)."""
    recorded_residual: Array
    """s as the monitor published it [m], one for each of its messages."""
    t_rotors: Array
    """Times of the rotor speeds [s], shape (r,)."""
    rotor_speed_hz: Array
    """Rotor speeds [Hz], shape (r, N_p)."""
    margins: MarginHistory
    """Margins of the controller steps; all zero while the mode is nominal."""
    t_solve: Array
    """Times of the controller steps [s], shape (k,)."""
    solve_ms: Array
    """Time per controller step [ms], shape (k,)."""
    modes: tuple[tuple[float, str], ...]
    """From when on [s] which controller mode was flown, in order; empty if not recorded."""
    deadline_ms: float
    """T_s, within which a step should be done [ms]; NaN if not recorded."""
    tower: Tower
    """What was flown around."""
    helix: ReferencePath
    """What was to be followed."""
    coverage: Coverage
    """What of the flight is recorded."""
    vehicle: Vehicle | None = None
    """What was flown; None if that was not recorded, or is not known here."""
    clearance_from: str = "odom"
    """Topic of which position, clearance and every statistic are: ``ground_truth`` or ``odom``."""
    guarded: tuple[tuple[float, float], ...] | None = None
    """From when to when [s] the guard was in charge, in order; None if that was not recorded."""
    zeta: tuple[float, ...] | None = None
    """The true mismatch and wind bias, eq. (4), 9 numbers; None if not recorded."""
    gust: str | None = None
    """Which gusts blew; None if not recorded."""
    seed: int | None = None
    """Seed of the gusts; None if not recorded."""
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Last known value of every parameter, by fully qualified node name."""
    truncated: bool = False
    """Whether the bag has no end, because its writer was killed."""
    late: Mapping[str, int] = field(default_factory=dict)
    """By topic, how many messages came behind newer ones; they are sorted in by their stamps."""
    notes: tuple[str, ...] = ()
    """What a user should know, one sentence each."""
    predictions: Predictions | None = None
    """What the controller foresaw; None if that was not looked into."""
    t_command: Array = field(default_factory=lambda: np.zeros(0))
    """From when on [s] each command acts, shape (c,); empty if not recorded."""
    command_hz_s: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Rotor accelerations commanded [Hz/s], shape (c, N_p)."""
    t_wind: Array = field(default_factory=lambda: np.zeros(0))
    """Times of wind and gust [s], shape (w,); empty if not recorded."""
    wind_n: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """Force of the wind without gusts, world ENU [N], shape (w, 3): w_b where the world has no
    wind field, else the field's force on the vehicle at hover."""
    gust_n: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """Gust force w_g, world ENU [N], shape (w, 3)."""
    replayed: bool = False
    """Whether margins, predictions and solve times are of a controller that was fed the recorded
    states again and did not fly."""

    @classmethod
    def from_rows(
        cls,
        rows: Mapping[str, ArrayLike],
        *,
        name: str,
        mode: str,
        tower: Tower,
        helix: ReferencePath,
        vehicle: Vehicle | None = None,
        gust: str | None = None,
        seed: int | None = None,
        sampling_time_s: float | None = None,
        source: Path = Path(),
    ) -> Flight:
        """Make a flight of the rows that ``gtmr fly`` keeps, one a sampling time.

        Parameters
        ----------
        rows : mapping
            By name, as in the npz of ``gtmr fly``: an opened npz, or ``vars(log)`` of a
            `gtmr_sim.FlightLog`. ``t``, ``x`` and ``u`` have to be there; ``alpha_p``,
            ``alpha_g``, ``slack``, ``solve_ms``, ``zeta``, ``wind_n``, ``w_g`` and ``guard`` are
            taken if they are, and others are left out. Shapes, units and frames are those of the
            log; where a controller tells no margins they have shape (K, 0).
        name : str
            What to call it.
        mode : str
            Controller mode, or the class of a controller of one's own.
        tower : Tower
            What was flown around.
        helix : ReferencePath
            What was to be followed.
        vehicle : Vehicle, optional
            What was flown; tells rotor limits and the airframe.
        gust : str, optional
            Which gusts blew.
        seed : int, optional
            Seed of the gusts.
        sampling_time_s : float, optional
            T_s [s], the deadline of a step; if left out, the distance of the first two rows.
        source : Path, optional
            The file that the rows came from.

        Raises
        ------
        ValueError
            If a row that has to be there is not, or has another shape than the log's.
        """
        taken = {key: np.asarray(rows[key]) for key in _ROWS if key in rows}
        t, x, u = _required(taken)
        told = {key: taken[key] for key in ("alpha_p", "alpha_g", "slack") if key in taken}
        if len(told) < 3 or told["slack"].size == 0:
            told = dict.fromkeys(("alpha_p", "alpha_g", "slack"), np.zeros((0, 0)))
        steps, stages = told["slack"].shape
        solve_ms = taken.get("solve_ms", np.zeros(0))
        wind = taken.get("wind_n", np.zeros((0, 3)))
        if sampling_time_s is None:
            sampling_time_s = float(t[1] - t[0]) if t.size > 1 else math.nan
        return cls(
            name=name,
            source=source,
            t=t,
            p=x[:, :3],
            eta=np.column_stack([x[:, 3:5], np.unwrap(x[:, 5])]),
            recorded_residual=tower.residual(x[:, :3]),
            t_rotors=t,
            rotor_speed_hz=x[:, 12:],
            margins=MarginHistory(
                t[:steps],
                np.zeros((steps, stages, 0)),
                np.zeros((steps, stages)),
                told["alpha_g"],
                told["slack"],
                parametric=told["alpha_p"],
            ),
            t_solve=t[: solve_ms.size],
            solve_ms=solve_ms,
            modes=((0.0, mode),),
            deadline_ms=1e3 * sampling_time_s,
            tower=tower,
            helix=helix,
            coverage=Coverage(covered_s=float(t[-1]), expected_s=float(t[-1])),
            vehicle=vehicle,
            clearance_from="ground_truth",
            guarded=_spans(t, taken["guard"]) if "guard" in taken else None,
            zeta=tuple(taken["zeta"].tolist()) if "zeta" in taken else None,
            gust=gust,
            seed=seed,
            t_command=t,
            command_hz_s=u,
            t_wind=t[: len(wind)],
            wind_n=wind,
            gust_n=taken.get("w_g", np.zeros_like(wind)),
        )

    @property
    def mode(self) -> str:
        """Modes flown, joined by an arrow if it was switched; ``unknown`` if not recorded."""
        return " → ".join(mode for _, mode in self.modes) or "unknown"

    @property
    def duration_s(self) -> float:
        """From the first odometry to the last [s]."""
        return float(self.t[-1])

    @cached_property
    def clearance(self) -> Array:
        """d_T at the times ``t`` [m], shape (n,)."""
        return self.tower.clearance(self.p)

    @cached_property
    def airframe_clearance(self) -> Array | None:
        """Clearance of the nearest rotor disc at the times of the odometry [m], shape (n,).

        None if the vehicle is not known.
        """
        if self.vehicle is None:
            return None
        return airframe_clearance(np.hstack([self.p, self.eta]), self.vehicle, self.tower)

    @cached_property
    def residual(self) -> Array:
        """Residual s = d_min - d_T at the times ``t`` [m], shape (n,)."""
        return self.tower.residual(self.p)

    @cached_property
    def tracking_error(self) -> Array:
        """Distance to where the reference is at the times ``t`` [m], shape (n,)."""
        error: Array = np.linalg.norm(self.p - self.helix.at(self.t, self.tower).position, axis=1)
        return error

    @cached_property
    def heading_error(self) -> Array:
        """Yaw minus the bearing to the tower's axis [rad], shape (n,), within +-pi."""
        bearing = np.arctan2(-self.p[:, 1], -self.p[:, 0])
        error: Array = np.angle(np.exp(1j * (self.eta[:, 2] - bearing)))
        return error

    @property
    def deadline_misses(self) -> int | None:
        """How many controller steps took longer than T_s; None if that was not recorded."""
        if not self.solve_ms.size or np.isnan(self.deadline_ms):
            return None
        return int((self.solve_ms > self.deadline_ms).sum())

    @property
    def guard_time_s(self) -> float | None:
        """For how long the guard was in charge [s]; None if that was not recorded."""
        return None if self.guarded is None else sum(end - begin for begin, end in self.guarded)

    @property
    def residual_statistics(self) -> ResidualStatistics:
        """The clearance residual in figures."""
        return residual_statistics(self.residual, self.tower.min_clearance_m)

    @property
    def solve_statistics(self) -> SolveStatistics | None:
        """The solve times in figures [ms]; None if none was recorded."""
        return solve_statistics(self.solve_ms) if self.solve_ms.size else None


_ROWS = (
    "t", "x", "u", "alpha_p", "alpha_g", "slack", "solve_ms", "zeta", "wind_n", "w_g", "guard"
)  # fmt: skip


def _required(taken: Mapping[str, NDArray[Any]]) -> tuple[Array, Array, Array]:
    """Pick t, x and u; ValueError if they are no rows of one flight."""
    for key in ("t", "x", "u"):
        if key not in taken:
            raise ValueError(f"a flight has rows {key}; there is {', '.join(taken) or 'nothing'}")
    t, x, u = (np.asarray(taken[key], dtype=float) for key in ("t", "x", "u"))
    n, n_rotors = len(t), u.shape[-1]
    if t.shape != (n,) or n == 0 or u.shape != (n, n_rotors) or x.shape != (n, 12 + n_rotors):
        raise ValueError(
            f"t, x and u have shapes {t.shape}, {x.shape} and {u.shape}: expected (K,), "
            "(K, 12 + N_p) and (K, N_p), K at least 1"
        )
    return t, x, u


def _spans(t: Array, inside: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """From when to when [s] something was so at the end of each row's period."""
    edges = np.flatnonzero(np.diff(np.r_[False, inside, False].astype(int)))
    last = len(t) - 1
    return tuple(
        (float(t[begin]), float(t[min(end, last)]))
        for begin, end in zip(edges[::2], edges[1::2], strict=True)
    )
