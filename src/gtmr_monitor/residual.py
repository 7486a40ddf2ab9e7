# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Statistics of the clearance residual s = d_min - d_T (Fig. 2, Table II) and of solve times."""

import math
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Distribution(TypedDict):
    """Minimum, quartiles and maximum: what a box plot draws."""

    min: float
    q1: float
    median: float
    q3: float
    max: float


class ResidualStatistics(TypedDict):
    """One flight's clearance in figures; the keys are those of the JSON output."""

    min_clearance_m: float
    violated: bool
    samples: int
    residual_m: Distribution


class SolveStatistics(TypedDict):
    """One flight's solve times in figures [ms]."""

    median: float
    p99: float
    max: float


def residual_statistics(residual_m: ArrayLike, min_clearance_m: float) -> ResidualStatistics:
    """Summarise the clearance residual of a flight.

    Parameters
    ----------
    residual_m : array_like, shape (n,)
        s = d_min - d_T(p) at n instants [m]; above zero the constraint (1) is violated.
    min_clearance_m : float
        d_min, the least admissible clearance [m].

    Returns
    -------
    ResidualStatistics
        ``min_clearance_m`` is the least clearance seen, d_min - max s [m]; ``violated`` says
        whether any instant violates, as Table II counts trials; quartiles interpolate linearly.

    Raises
    ------
    ValueError
        If there is no sample, or one is not a finite number.
    """
    s = _samples("residual_m", residual_m)
    low, q1, median, q3, high = (float(q) for q in np.percentile(s, (0, 25, 50, 75, 100)))
    return {
        "min_clearance_m": min_clearance_m - high,
        "violated": high > 0.0,
        "samples": int(s.size),
        "residual_m": {"min": low, "q1": q1, "median": median, "q3": q3, "max": high},
    }


def solve_statistics(solve_ms: ArrayLike) -> SolveStatistics:
    """Summarise the solve times of a flight [ms].

    Raises ValueError if there is no sample, or one is not a finite number.
    """
    median, p99, high = np.percentile(_samples("solve_ms", solve_ms), (50, 99, 100))
    return {"median": float(median), "p99": float(p99), "max": float(high)}


@dataclass
class ResidualWatch:
    """The residual of a flight in progress: now, at its worst, and how often it was violated."""

    current_m: float = math.nan
    """s now [m]; NaN before the first sample."""
    worst_m: float = -math.inf
    """The largest s so far [m]."""
    samples: int = 0
    """How many samples there were."""
    violations: int = 0
    """How many of them violated the clearance constraint."""

    def update(self, residual_m: float, late: bool = False) -> None:
        """Take in a sample s = d_min - d_T(p) [m]; one that comes late is not the current one."""
        if not late:
            self.current_m = residual_m
        self.worst_m = max(self.worst_m, residual_m)
        self.samples += 1
        self.violations += residual_m > 0.0


def _samples(name: str, values: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=float).ravel()
    if array.size == 0:
        raise ValueError(f"{name} has no samples")
    if not np.isfinite(array).all():
        index = int(np.flatnonzero(~np.isfinite(array))[0])
        raise ValueError(f"{name}[{index}] = {array[index]}: expected a finite number")
    return array
