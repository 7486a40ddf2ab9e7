# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the paper reports (Table II, Fig. 2), and how far a campaign is from it."""

import math
from dataclasses import dataclass
from typing import Any

from gtmr_nmpc import PAPER_MODES, Mode

TRIALS = 500
"""Realizations a mode in Table II."""
FIG_1_ZETA = (0.0,) * 6 + (0.6, 0.4, 0.0)
"""zeta of Fig. 1: nothing but the wind bias w_b, world frame [N]."""


@dataclass(frozen=True)
class Reported:
    """What the paper says of one mode."""

    violations: int
    """Trials with a violation, of 500 (Table II)."""
    min_clearance_m: float
    """Table II [m]."""
    solve_ms: float
    """Average solve time in MATLAB (Table II) [ms]."""
    residual_m: dict[str, float]
    """Whiskers and quartiles of s, as they are drawn in Fig. 2 [m]."""


PAPER: dict[Mode, Reported] = {
    "nominal": Reported(
        violations=230,
        min_clearance_m=0.182,
        solve_ms=9.4,
        residual_m={"min": -0.25, "q1": -0.22, "median": -0.15, "q3": -0.08, "max": 0.018},
    ),
    "robust": Reported(
        violations=0,
        min_clearance_m=0.364,
        solve_ms=18.7,
        residual_m={"min": -0.28, "q1": -0.24, "median": -0.19, "q3": -0.16, "max": -0.114},
    ),
}
"""The paper's rows by mode."""
MEDIAN_CLEARANCE_M = 0.40
"""Of the robust controller, in the text of Sec. VII [m]."""

RATE_TOLERANCE = 40 / TRIALS
"""What counts as one unit of distance in the share of violating trials [-]."""
CLEARANCE_TOLERANCE_M = 0.01
"""Likewise, in the least clearance [m]."""
RESIDUAL_TOLERANCE_M = 0.02
"""Likewise, in a quartile or whisker [m]."""


def deviations(summary: dict[str, Any], mode: Mode) -> dict[str, float]:
    """Compare a mode's figures with the paper's: ours minus theirs, over the tolerances [-].

    Share of violating trials, least clearance, whiskers and quartiles of the residual. Infinite if
    no trial flew.
    """
    row = PAPER[mode]
    if not summary["trials"]:
        return {"violations": math.inf}
    rate = summary["violations"] / summary["trials"]
    return {
        "violations": (rate - row.violations / TRIALS) / RATE_TOLERANCE,
        "min_clearance": (summary["min_clearance_m"] - row.min_clearance_m)
        / CLEARANCE_TOLERANCE_M,
        **{
            f"residual_{key}": (summary["residual_m"][key] - value) / RESIDUAL_TOLERANCE_M
            for key, value in row.residual_m.items()
        },
    }


def distance(summary: dict[str, dict[str, Any]], modes: tuple[Mode, ...]) -> float:
    """Root mean square of the deviations of some rows [-]; 0 if all figures are the paper's."""
    squares = [d**2 for mode in modes for d in deviations(summary[mode], mode).values()]
    return math.sqrt(sum(squares) / len(squares))


def distances(summary: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Distance to the paper's ``nominal`` rows, and to those of ``both`` modes [-]."""
    return {"nominal": distance(summary, ("nominal",)), "both": distance(summary, PAPER_MODES)}
