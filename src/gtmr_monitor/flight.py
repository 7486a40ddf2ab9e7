# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A recorded flight: what reports are made from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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

    @property
    def alpha_p(self) -> Array:
        """Parametric margin, eq. (12), eps_s included [m], shape (M, N + 1)."""
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
    """One flight as it was recorded; every time is in seconds since its first odometry.

    Position and attitude are the truth, where that was recorded; else the measured odometry.
    """

    name: str
    """What to call it."""
    source: Path
    """The bag."""
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
    replayed: bool = False
    """Whether margins, predictions and solve times are of a controller that was fed the recorded
    states again and did not fly."""

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
