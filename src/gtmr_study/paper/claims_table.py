# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Every claim of the paper, what was found here, by which command, and a verdict."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace as Values
from typing import Any, NamedTuple

import numpy as np

from gtmr_model import N_ZETA, Helix
from gtmr_nmpc import PAPER_MODES, ControllerConfig, Mode
from gtmr_sim import GustConfig
from gtmr_study.campaign.study import Study
from gtmr_study.paper.claims import (
    FIG_1_ZETA,
    MEDIAN_CLEARANCE_M,
    PAPER,
    RESIDUAL_TOLERANCE_M,
    TRIALS,
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
    command: str
    """What shows it."""


class _Statement(NamedTuple):
    """How a claim is tried; texts are formats of the values that `_values` gives."""

    claim: str
    paper: str
    here: str
    met: Callable[[Values], bool | str]
    """Whether it holds, or a verdict of its own."""
    command: str = "{reproduce}"


# One claim after the other: what is claimed; the paper's value, ours; whether it holds.
# fmt: off
_REALIZATIONS = _Statement(
    "realizations a mode (Table II)", f"{TRIALS}", "{least}", lambda v: v.least >= TRIALS)
_OF_A_MODE = (
    _Statement("{mode}: trials with a violation (Table II)", f"{{paper.violations}} of {TRIALS}",
        "{ours[violations]} of {ours[trials]} ({low:.1f} to {high:.1f} %)",
        lambda v: abs(v.off["violations"]) <= 1.0),
    _Statement("{mode}: least clearance (Table II)",
        "{paper.min_clearance_m:.3f} m", "{ours[min_clearance_m]:.3f} m",
        lambda v: abs(v.off["min_clearance"]) <= 1.0),
    *(_Statement(f"{{mode}}: residual, {name} (Fig. 2)",
        f"{{paper.residual_m[{key}]:.3f}} m", f"{{ours[residual_m][{key}]:.3f}} m",
        lambda v, key=key: abs(v.off[f"residual_{key}"]) <= 1.0)  # type: ignore[misc]
      for name, key in (("lower whisker", "min"), ("lower quartile", "q1"), ("median", "median"),
                        ("upper quartile", "q3"), ("upper whisker", "max"))),
)
_OF_BOTH = (
    _Statement(
        "trials in which the nominal controller violates and the robust one does not (abstract)",
        "{paper[nominal].violations}, none is left", "{nominal[violations]}, {left} left",
        lambda v: v.robust["violations"] == 0 < v.nominal["violations"]),
    _Statement("robust: success rate (Sec. VII)", "100 %", "{success:.4g} %",
        lambda v: v.robust["violations"] == 0),
    _Statement("robust: the whole distribution strictly below zero (Fig. 2)",
        "at most {paper[robust].residual_m[max]:.3f} m", "at most {robust[residual_m][max]:.3f} m",
        lambda v: v.robust["residual_m"]["max"] < 0.0),
    _Statement("nominal: distribution centred near d_min - d_ref (Sec. VII)",
        "{centre:.2f} m", "{nominal[residual_m][median]:.3f} m",
        lambda v: _near(v.nominal["residual_m"]["median"], v.centre)),
    _Statement("robust: distribution further in the safe region, by the medians (Sec. VII)",
        "by {their_shift_mm:.1f} mm", "by {shift_mm:.1f} mm",
        lambda v: _near(1e-3 * v.shift_mm, 1e-3 * v.their_shift_mm)),
    _Statement("robust: median clearance (Sec. VII)",
        f"about {MEDIAN_CLEARANCE_M:.2f} m", "{robust[median_clearance_m]:.3f} m",
        lambda v: _near(v.robust["median_clearance_m"], MEDIAN_CLEARANCE_M)),
    _Statement("robust: median clearance above d_ref (Sec. VII)",
        "above {d_ref:.3f} m", "{robust[median_clearance_m]:.3f} m",
        lambda v: v.robust["median_clearance_m"] > v.d_ref),
    _Statement("robust keeps more clearance than nominal, by the least (conclusions)",
        "{paper[robust].min_clearance_m:.3f} m against {paper[nominal].min_clearance_m:.3f} m",
        "{robust[min_clearance_m]:.3f} m against {nominal[min_clearance_m]:.3f} m",
        lambda v: v.robust["min_clearance_m"] > v.nominal["min_clearance_m"]),
    _Statement("robust: additional clearance where the sensitivity is high (Sec. VII)",
        "more there", "{extra_mm:.1f} mm more there",
        lambda v: v.extra_mm >= 1e3 * PLACED_M),
    _Statement("robust keeps a larger clearance under the wind of Fig. 1", "larger",
        "{windy[robust][min_clearance_m]:.3f} m against {windy[nominal][min_clearance_m]:.3f} m",
        lambda v: v.windy["robust"]["min_clearance_m"] > v.windy["nominal"]["min_clearance_m"],
        "{fly}"),
    _Statement("nominal tracks the reference more closely there, RMS distance (Sec. VII)",
        "more closely",
        "{windy[nominal][tracking_rms_m]:.3f} m against {windy[robust][tracking_rms_m]:.3f} m",
        lambda v: v.windy["nominal"]["tracking_rms_m"] < v.windy["robust"]["tracking_rms_m"]),
    _Statement("the vehicle faces the tower without pitching to it there (Sec. II-B)",
        "no pitch", "at most {tilt:.1f} deg of tilt, {off_tower:.1f} deg off its axis",
        lambda v: v.tilt <= LEVEL_DEG and v.off_tower < v.edge_deg),
    *(_Statement(f"{mode}: average solve time, there in MATLAB (Table II)",
        f"{{paper[{mode}].solve_ms:.1f}} ms", f"{{{mode}[solve_ms][mean]:.2f}} ms",
        lambda v: NOT_COMPARABLE) for mode in PAPER_MODES),
    _Statement(
        "robust over nominal average solve time, moderate, about twofold (abstract, Sec. VII)",
        "{their_factor:.2f}", "{factor:.2f}",
        lambda v: abs(v.factor / v.their_factor - 1.0) <= SOLVE_FACTOR_TOLERANCE
        or (LOWER if v.factor < v.their_factor else NOT_MET)),
    _Statement("the optimization's structure is that of the nominal problem (abstract)",
        "unchanged", "the same QP, another bound{gradient}",
        lambda v: MET, "pytest tests/nmpc/test_rti_against_ipopt.py"),
    _Statement("sensitivity states a stage, and over the horizon (Sec. V-A)",
        "162, 3240", "{states}, {all_states}",
        lambda v: (v.states, v.all_states) == (162, 3240)),
    _Statement("Hoelder's bound is looser than eq. (12) (Sec. V-C)",
        "looser", "at least {hoelder:.2f} times as large", lambda v: v.hoelder > 1.0),
    _Statement("gusts change a plan's clearance by at most alpha_g (Sec. V-D)",
        "at most 1.00 of it", "at most {gust:.2f} of it", lambda v: v.gust <= 1.0),
    _Statement("mismatch in the bounds changes it by at most alpha_p (Sec. V-C, conclusions)",
        "at most 1.00 of it, to first order", "at most {used[parametric]:.2f} of it in flights, "
        "{used[worst_parametric]:.2f} at a vertex of the bounds",
        lambda v: max(v.used["parametric"], v.used["worst_parametric"]) <= 1.0),
    _Statement("both together change it by at most alpha_p + alpha_g (conclusions)",
        "at most 1.00 of it", "at most {used[both]:.2f} of it in flights",
        lambda v: v.used["both"] <= 1.0),
    _Statement("tilted rotors widen the set of thrust directions (Sec. II-B)",
        "wider than collinear",
        "forces in {force_rank} dimensions, collinear in 1; gust rejection not compared",
        lambda v: v.force_rank > 1),
)
# fmt: on


def claims(study: Study, results: dict[str, Any]) -> list[Claim]:
    """Set every claim of the paper beside what was found, with a verdict on each.

    Figures are met within the tolerances of `deviations`; comparisons if they hold.
    """
    values = _values(study, results)
    found = [_tried(_REALIZATIONS, values)]
    for mode in PAPER_MODES:
        found += [_tried(statement, _of_mode(values, mode)) for statement in _OF_A_MODE]
    return found + [_tried(statement, values) for statement in _OF_BOTH]


def _tried(statement: _Statement, values: Values) -> Claim:
    met = statement.met(values)
    verdict = met if isinstance(met, str) else MET if met else NOT_MET
    claim, paper, here, _, command = statement
    claim, paper, here, command = (
        text.format(**vars(values)) for text in (claim, paper, here, command)
    )
    return Claim(claim, paper, here, verdict, command)


def _near(ours_m: float, theirs_m: float) -> bool:
    return abs(ours_m - theirs_m) <= RESIDUAL_TOLERANCE_M


def _of_mode(values: Values, mode: Mode) -> Values:
    """Make the values that one mode's row of Table II and box of Fig. 2 are tried by."""
    ours = getattr(values, mode)
    low, high = (100.0 * bound for bound in ours["violation_rate_95"])
    off = deviations(ours, mode)
    own = {"mode": mode, "ours": ours, "paper": PAPER[mode], "off": off}
    return Values(**vars(values) | own, low=low, high=high)


def _values(study: Study, results: dict[str, Any]) -> Values:
    """Make the values that claims are tried by."""
    config, summary, windy = study.controller, results["summary"], results["fig_1"]
    nominal, robust, tower = summary["nominal"], summary["robust"], config.tower
    shift_m = nominal["residual_m"]["median"] - robust["residual_m"]["median"]
    their_shift_m = PAPER["nominal"].residual_m["median"] - PAPER["robust"].residual_m["median"]
    offset_m = Helix.required(config.helix).offset_m
    found = {part: by for part, by in results["first_order"].items() if part != "plans"}
    used = {part: max(by_stage["max"]) for part, by_stage in found.items()}
    states = N_ZETA * config.vehicle.n_x
    edge = np.arcsin(tower.radius_m / (tower.radius_m + tower.min_clearance_m))
    return Values(
        nominal=nominal,
        robust=robust,
        paper=PAPER,
        windy=windy,
        used=used,
        reproduce=results["command"],
        fly=_fly_command(study) or results["command"],
        least=min(nominal["trials"], robust["trials"]),
        left=robust["violations"] or "none",
        success=100.0 * (1.0 - robust["violations"] / robust["trials"]),
        d_ref=offset_m,
        centre=tower.min_clearance_m - offset_m,
        shift_mm=1e3 * shift_m,
        their_shift_mm=1e3 * their_shift_m,
        # Rounded, with no sign on what is none.
        extra_mm=round(1e3 * results["calm"]["extra_clearance_m"], 1) + 0.0,
        tilt=max(windy[mode]["tilt_deg"] for mode in PAPER_MODES),
        off_tower=max(windy[mode]["off_tower_deg"] for mode in PAPER_MODES),
        edge_deg=np.degrees(edge),
        factor=robust["solve_ms"]["mean"] / nominal["solve_ms"]["mean"],
        their_factor=PAPER["robust"].solve_ms / PAPER["nominal"].solve_ms,
        gradient="" if config.tightening == "frozen" else " and gradient",
        states=states,
        all_states=states * config.horizon,
        hoelder=results["hoelder_ratio"],
        gust=max(used["gust"], used["worst_gust"]),
        force_rank=int(np.linalg.matrix_rank(config.vehicle.allocation[:3])),
    )


def _fly_command(study: Study) -> str:
    """Find the robust flight of Fig. 1 as a command of its own, if the study is the default."""
    zeta = " ".join(f"{value:g}" for value in FIG_1_ZETA)
    flight = f"gtmr fly --mode robust --seed {study.seed} --zeta {zeta}"
    if study.duration_s != 50.0:
        flight += f" --duration {study.duration_s:g}"
    default = (ControllerConfig(), GustConfig(), None)
    return flight if (study.controller, study.gust, study.uncertainty) == default else ""


def claims_markdown(found: dict[str, Sequence[Claim]]) -> str:
    """Write a table of the same claims as found with one controller or with several, by its name.

    The commands are those of the first.
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
    """Write a table of rows in Markdown; the first has the titles of the columns."""
    lines = [rows[0], ["---"] * len(rows[0]), *rows[1:]]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
