# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Every claim of the paper, what was found here, by which command, and a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gtmr_model import N_ZETA
from gtmr_nmpc import MODES, ControllerConfig
from gtmr_sim import GustConfig
from gtmr_study.campaign.study import Study
from gtmr_study.paper.claims import (
    MEDIAN_CLEARANCE_M,
    PAPER,
    RESIDUAL_TOLERANCE_M,
    TRIALS,
    WIND_BIAS_N,
    deviations,
)

MET, NOT_MET, LOWER, NOT_COMPARABLE = "met", "not met", "lower", "not comparable"
"""What a verdict can be. Lower is said of a cost, which is then better than the paper's."""
SOLVE_FACTOR_TOLERANCE = 0.25
"""By how much a factor of two may be off to count as approximately twofold [-]."""
LEVEL_DEG = 5.0
"""Roll and pitch up to which a vehicle counts as level [deg]."""
PLACED_M = 0.005
"""Additional clearance from which it counts as placed where the sensitivity is high [m]."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, tried."""

    claim: str
    """What is claimed, and where in the paper."""
    paper: str
    """The paper's value."""
    here: str
    """Ours."""
    verdict: str
    """Whether they agree."""
    command: str = ""
    """What shows it; empty if it is the reproduction itself."""


def claims(study: Study, results: dict[str, Any]) -> list[Claim]:
    """Set every claim of the paper beside what was found, with a verdict on each.

    Figures are met within the tolerances of `deviations`; comparisons if they hold.

    Parameters
    ----------
    study : Study
        What was flown.
    results : dict
        Content of reproduction.json, see `reproduce`.

    Returns
    -------
    list of Claim
    """
    summary = results["summary"]
    rows = [
        *_figures(summary),
        *_comparisons(study.controller, summary),
        _placed(results["calm"]),
        *_fig_1(study, results["fig_1"]),
        *_solve_times(summary),
        *_of_the_formulas(study.controller, results),
    ]
    return [replace(row, command=row.command or results["command"]) for row in rows]


def claims_markdown(found: dict[str, Sequence[Claim]]) -> str:
    """Write a table of claims.

    Parameters
    ----------
    found : dict
        The same claims as found with one controller or with several, by the controller's name;
        the commands are those of the first.

    Returns
    -------
    str
    """
    several = len(found) > 1
    verdicts = [f"verdict, {name}" if several else "verdict" for name in found]
    rows = [["claim", "paper", *found, "command", *verdicts]]
    for same in zip(*found.values(), strict=True):
        first = same[0]
        values, outcomes = [claim.here for claim in same], [claim.verdict for claim in same]
        rows.append([first.claim, first.paper, *values, f"`{first.command}`", *outcomes])
    return markdown_table(rows)


def markdown_table(rows: Sequence[Sequence[str]]) -> str:
    """Write a table.

    Parameters
    ----------
    rows : sequence of sequence of str
        The titles of the columns, then the rows.

    Returns
    -------
    str
    """
    lines = [rows[0], ["---"] * len(rows[0]), *rows[1:]]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


_RESIDUAL_NAMES = {
    "lower whisker": "min",
    "lower quartile": "q1",
    "median": "median",
    "upper quartile": "q3",
    "upper whisker": "max",
}


def _verdict(met: bool) -> str:
    return MET if met else NOT_MET


def _figures(summary: dict[str, Any]) -> list[Claim]:
    """Table II and Fig. 2, figure by figure."""
    least = min(summary[mode]["trials"] for mode in MODES)
    rows = [
        Claim("realizations a mode (Table II)", str(TRIALS), str(least), _verdict(least >= TRIALS))
    ]
    for mode, paper in PAPER.items():
        ours, off = summary[mode], deviations(summary[mode], mode)
        low, high = (100.0 * bound for bound in ours["violation_rate_95"])
        rows.append(
            Claim(
                f"{mode}: trials with a violation (Table II)",
                f"{paper.violations} of {TRIALS}",
                f"{ours['violations']} of {ours['trials']} ({low:.1f} to {high:.1f} %)",
                _verdict(abs(off["violations"]) <= 1.0),
            )
        )
        lengths = [
            ("least clearance (Table II)", "min_clearance", paper.min_clearance_m,
             ours["min_clearance_m"])
        ]  # fmt: skip
        lengths += [
            (f"residual, {name} (Fig. 2)", f"residual_{key}", paper.residual_m[key],
             ours["residual_m"][key])
            for name, key in _RESIDUAL_NAMES.items()
        ]  # fmt: skip
        rows += [
            Claim(
                f"{mode}: {name}",
                f"{theirs:.3f} m",
                f"{length:.3f} m",
                _verdict(abs(off[key]) <= 1.0),
            )
            for name, key, theirs, length in lengths
        ]
    return rows


def _comparisons(config: ControllerConfig, summary: dict[str, Any]) -> list[Claim]:
    """Try what the text says of the two controllers, in words or in round numbers."""
    nominal, robust = summary["nominal"], summary["robust"]
    theirs, d_min = PAPER["robust"], config.tower.min_clearance_m
    d_ref = config.helix.offset_m
    violated, left = nominal["violations"], robust["violations"]
    shift = nominal["residual_m"]["median"] - robust["residual_m"]["median"]
    their_shift = PAPER["nominal"].residual_m["median"] - theirs.residual_m["median"]
    nominal_m, robust_m = nominal["min_clearance_m"], robust["min_clearance_m"]
    median_m, highest_m = robust["median_clearance_m"], robust["residual_m"]["max"]
    centre_m = nominal["residual_m"]["median"]
    success = 100.0 * (1.0 - left / robust["trials"])
    return [
        Claim(
            "trials in which the nominal controller violates and the robust one does not "
            "(abstract)",
            f"{PAPER['nominal'].violations}, none is left",
            f"{violated}, {left or 'none'} left",
            _verdict(left == 0 < violated),
        ),
        Claim("robust: success rate (Sec. VII)", "100 %", f"{success:.4g} %", _verdict(left == 0)),
        Claim(
            "robust: the whole distribution strictly below zero (Fig. 2)",
            f"at most {theirs.residual_m['max']:.3f} m",
            f"at most {highest_m:.3f} m",
            _verdict(highest_m < 0.0),
        ),
        Claim(
            "nominal: distribution centred near d_min - d_ref (Sec. VII)",
            f"{d_min - d_ref:.2f} m",
            f"{centre_m:.3f} m",
            _verdict(abs(centre_m - (d_min - d_ref)) <= RESIDUAL_TOLERANCE_M),
        ),
        Claim(
            "robust: distribution further in the safe region, by the medians (Sec. VII)",
            f"by {1e3 * their_shift:.1f} mm",
            f"by {1e3 * shift:.1f} mm",
            _verdict(abs(shift - their_shift) <= RESIDUAL_TOLERANCE_M),
        ),
        Claim(
            "robust: median clearance (Sec. VII)",
            f"about {MEDIAN_CLEARANCE_M:.2f} m",
            f"{median_m:.3f} m",
            _verdict(abs(median_m - MEDIAN_CLEARANCE_M) <= RESIDUAL_TOLERANCE_M),
        ),
        Claim(
            "robust: median clearance above d_ref (Sec. VII)",
            f"above {d_ref:.3f} m",
            f"{median_m:.3f} m",
            _verdict(median_m > d_ref),
        ),
        Claim(
            "robust keeps more clearance than nominal, by the least (conclusions)",
            f"{theirs.min_clearance_m:.3f} m against {PAPER['nominal'].min_clearance_m:.3f} m",
            f"{robust_m:.3f} m against {nominal_m:.3f} m",
            _verdict(robust_m > nominal_m),
        ),
    ]


def _solve_times(summary: dict[str, Any]) -> list[Claim]:
    ours = {mode: summary[mode]["solve_ms"]["mean"] for mode in MODES}
    rows = [
        Claim(
            f"{mode}: average solve time, there in MATLAB (Table II)",
            f"{PAPER[mode].solve_ms:.1f} ms",
            f"{ours[mode]:.2f} ms",
            NOT_COMPARABLE,
        )
        for mode in MODES
    ]
    theirs = PAPER["robust"].solve_ms / PAPER["nominal"].solve_ms
    factor = ours["robust"] / ours["nominal"]
    verdict = _verdict(abs(factor / theirs - 1.0) <= SOLVE_FACTOR_TOLERANCE)
    if factor < theirs and verdict == NOT_MET:
        verdict = LOWER
    name = "robust over nominal average solve time, moderate, about twofold (abstract, Sec. VII)"
    return [*rows, Claim(name, f"{theirs:.2f}", f"{factor:.2f}", verdict)]


def _of_the_formulas(config: ControllerConfig, results: dict[str, Any]) -> list[Claim]:
    """Try what is said of the method rather than of a flight."""
    found, stages = results["first_order"], config.horizon
    states = N_ZETA * config.vehicle.n_x
    force_rank = int(np.linalg.matrix_rank(config.vehicle.allocation[:3]))
    gust = max(*found["gust"]["max"], *found["worst_gust"]["max"])
    vertex, flown = max(found["worst_parametric"]["max"]), max(found["parametric"]["max"])
    both = max(found["both"]["max"])
    frozen = config.tightening == "frozen"
    return [
        Claim(
            "the optimization's structure is that of the nominal problem (abstract)",
            "unchanged",
            "the same QP, another bound" if frozen else "the same QP, another bound and gradient",
            MET,
            "pytest tests/test_rti_against_ipopt.py",
        ),
        Claim(
            "sensitivity states a stage, and over the horizon (Sec. V-A)",
            "162, 3240",
            f"{states}, {states * stages}",
            _verdict((states, stages) == (162, 20)),
        ),
        Claim(
            "Hoelder's bound is looser than eq. (12) (Sec. V-C)",
            "looser",
            f"at least {results['hoelder_ratio']:.2f} times as large",
            _verdict(results["hoelder_ratio"] > 1.0),
        ),
        Claim(
            "gusts change a plan's clearance by at most alpha_g (Sec. V-D)",
            "at most 1.00 of it",
            f"at most {gust:.2f} of it",
            _verdict(gust <= 1.0),
        ),
        Claim(
            "mismatch in the bounds changes it by at most alpha_p (Sec. V-C, conclusions)",
            "at most 1.00 of it, to first order",
            f"at most {flown:.2f} of it in flights, {vertex:.2f} at a vertex of the bounds",
            _verdict(max(flown, vertex) <= 1.0),
        ),
        Claim(
            "both together change it by at most alpha_p + alpha_g (conclusions)",
            "at most 1.00 of it",
            f"at most {both:.2f} of it in flights",
            _verdict(both <= 1.0),
        ),
        Claim(
            "tilted rotors widen the set of thrust directions (Sec. II-B)",
            "wider than collinear",
            f"forces in {force_rank} dimensions, collinear in 1; gust rejection not compared",
            _verdict(force_rank > 1),
        ),
    ]


def _placed(calm: dict[str, float]) -> Claim:
    # Rounded, with no sign on what is none.
    extra = round(calm["extra_clearance_m"], 4) + 0.0
    return Claim(
        "robust: additional clearance where the sensitivity is high (Sec. VII)",
        "more there",
        f"{1e3 * extra:.1f} mm more there",
        _verdict(extra >= PLACED_M),
    )


def _fig_1(study: Study, flights: dict[str, dict[str, float]]) -> list[Claim]:
    """Fig. 1 and what is said of it; it gives no numbers."""
    nominal, robust = flights["nominal"], flights["robust"]
    least = {mode: flights[mode]["min_clearance_m"] for mode in MODES}
    tracking = {mode: flights[mode]["tracking_rms_m"] for mode in MODES}
    tilt = max(nominal["tilt_deg"], robust["tilt_deg"])
    off = max(nominal["off_tower_deg"], robust["off_tower_deg"])
    tower = study.controller.tower
    edge = np.degrees(np.arcsin(tower.radius_m / (tower.radius_m + tower.min_clearance_m)))
    return [
        Claim(
            "robust keeps a larger clearance under the wind of Fig. 1",
            "larger",
            f"{least['robust']:.3f} m against {least['nominal']:.3f} m",
            _verdict(least["robust"] > least["nominal"]),
            _fly_command(study),
        ),
        Claim(
            "nominal tracks the reference more closely there, RMS distance (Sec. VII)",
            "more closely",
            f"{tracking['nominal']:.3f} m against {tracking['robust']:.3f} m",
            _verdict(tracking["nominal"] < tracking["robust"]),
        ),
        Claim(
            "the vehicle faces the tower without pitching to it there (Sec. II-B)",
            "no pitch",
            f"at most {tilt:.1f} deg of tilt, {off:.1f} deg off its axis",
            _verdict(tilt <= LEVEL_DEG and off < edge),
        ),
    ]


def _fly_command(study: Study) -> str:
    """Find the robust flight of Fig. 1 as a command of its own, if the study is the default."""
    zeta = " ".join(f"{value:g}" for value in (*(0.0,) * 6, *WIND_BIAS_N))
    flight = f"gtmr fly --mode robust --seed {study.seed} --zeta {zeta}"
    if study.duration_s != 50.0:
        flight += f" --duration {study.duration_s:g}"
    default = (ControllerConfig(), GustConfig(), None)
    return flight if (study.controller, study.gust, study.uncertainty) == default else ""
