# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How much of a flight its record covers, where it has gaps, and why."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

GAP_PERIODS = 1.5
"""Odometry further apart than so many of its periods has a gap in between; it comes on a grid,
and a real clock's jitter is less than half a period."""


@dataclass(frozen=True)
class Coverage:
    """What of a flight is known; times are in seconds since the first odometry that is left."""

    covered_s: float
    """For how long the odometry is there [s]."""
    expected_s: float
    """How long the flight was, as far as the record tells [s]."""
    gaps: tuple[tuple[float, float], ...] = ()
    """Beginning and end [s] of what is missing; before the first odometry they are negative."""
    causes: Mapping[str, int] = field(default_factory=dict)
    """What is wrong with the record, and how often."""
    lost_messages: Mapping[str, int] = field(default_factory=dict)
    """How many messages were recorded but cannot be read, by topic."""

    @property
    def whole(self) -> bool:
        """Whether nothing is known to be missing or damaged."""
        return not (self.gaps or self.causes or self.lost_messages)

    def __str__(self) -> str:
        """Say it in a few words, such as ``9.4 of 10.0 s, 2 gaps: damaged chunk``."""
        places = 1
        if self.gaps and f"{self.covered_s:.1f}" == f"{self.expected_s:.1f}":
            places = 3
        text = f"{self.covered_s:.{places}f} of {self.expected_s:.{places}f} s"
        if self.gaps:
            text += f", {len(self.gaps)} gap{'s' if len(self.gaps) > 1 else ''}"
        why = [cause if n == 1 else f"{n} × {cause}" for cause, n in self.causes.items()]
        lost = sum(self.lost_messages.values())
        why += [f"{lost} message{'s' if lost > 1 else ''} lost"] if lost else []
        return f"{text}: {', '.join(why)}" if why else text

    def as_json(self) -> dict[str, Any]:
        """Give it as plain data."""
        return {
            "covered_s": self.covered_s,
            "expected_s": self.expected_s,
            "gaps": [list(gap) for gap in self.gaps],
            "causes": dict(self.causes),
            "lost_messages": dict(self.lost_messages),
        }


def period_of(stamps_ns: NDArray[np.int64], told_s: float | None = None) -> float:
    """Estimate the period of odometry [s] by its stamps, growing, shape (n,); 0 if nothing tells.

    It is the median distance of neighbours, or the period that a parameter tells [s] if that is
    shorter, as where every second message is missing.
    """
    median_s = float(np.median(np.diff(stamps_ns))) * 1e-9 if stamps_ns.size > 1 else 0.0
    known = [period for period in (median_s, told_s or 0.0) if period > 0.0]
    return min(known, default=0.0)


def gaps_between(stamps_ns: Sequence[int], period_s: float) -> list[int]:
    """List the indices k behind which, before k + 1, stamps [ns] miss at least one in between."""
    longest_ns = GAP_PERIODS * period_s * 1e9
    apart_ns = (after - before for before, after in pairwise(stamps_ns))
    return [k for k, ns in enumerate(apart_ns) if ns > longest_ns] if period_s else []
