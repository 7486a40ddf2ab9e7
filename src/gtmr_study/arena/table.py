# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the flights of an arena say, a cell at a time, and who flies closest in each world."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pandas as pd

from gtmr_study.arena.flight import STOPPED
from gtmr_study.arena.plan import Arena, Cell
from gtmr_study.campaign.summary import wilson_interval
from gtmr_study.campaign.trial import FLOWN

FLIES_WITHIN_M = 0.02
"""How far the mean d_T may be from d_ref for a controller to really fly it [m]."""
BEYOND_KNOWLEDGE = ("oracle",)
"""Controllers that know what nobody can know: they show the limit, and are never the choice."""
ENOUGH_TRIALS = 35
"""Without a violation in so many trials their rate is below 10 % with 95 % confidence."""

Result = dict[str, Any]


def results_of(arena: Arena, rows: pd.DataFrame) -> list[Result]:
    """Boil flights down to one object a cell, as arena.json has them, in the order of the plan.

    ``trials`` are those flown to the end; ``errors`` are the others, which raised, diverged or
    were stopped, and ``reason`` says why the first of them did. ``violations`` are trials with
    d_T < d_min at any plant step, ``violations_95`` the bounds of their rate (Wilson 1927).
    ``min_clearance_m`` and ``mean_clearance_m`` are of d_T; ``radial_rms_settled_m`` is the root
    mean square of d_T - d_ref after the first 5 s, ``u_rms_hz_s`` that of all rotor
    accelerations, both over all trials; ``step_ms`` is the median over trials of a trial's median.
    What no trial tells is None. ``flies_d_ref`` is whether the mean d_T is within
    `FLIES_WITHIN_M` of d_ref, ``missing`` how many flights are still to come.
    """
    by_cell = dict(iter(rows.groupby(["controller", "world", "d_ref_m"], sort=False)))
    nothing = rows.iloc[:0]
    return [_result(arena, cell, by_cell.get(tuple(cell), nothing)) for cell in arena.cells()]


def _result(arena: Arena, cell: Cell, rows: pd.DataFrame) -> Result:
    flown, failed = rows[rows["status"] == FLOWN], rows[rows["status"] != FLOWN]
    n = len(flown)
    violations = int(flown["violated_any_time"].astype(bool).sum())
    mean_m = _mean(flown["mean_clearance_m"])
    return {
        **cell._asdict(),
        "trials": n,
        "violations": violations,
        "min_clearance_m": float(flown["min_clearance_any_time_m"].min()) if n else None,
        "mean_clearance_m": mean_m,
        "radial_rms_settled_m": _rms(flown["radial_rms_settled_m"]),
        "u_rms_hz_s": _rms(flown["u_rms_hz_s"]),
        "step_ms": _step_ms(flown if n else failed),
        "violations_95": list(wilson_interval(violations, n)),
        "flies_d_ref": mean_m is not None and abs(mean_m - cell.d_ref_m) <= FLIES_WITHIN_M,
        "errors": len(failed),
        "reason": _reason(arena, failed),
        "missing": arena.trials_of(cell.controller) - len(rows),
        "family": arena.family_of(cell.controller),
    }


def _reason(arena: Arena, failed: pd.DataFrame) -> str:
    """Say why flights of a cell were not flown to the end; empty if all were."""
    if failed.empty:
        return ""
    first = failed.sort_values("trial").iloc[0]
    if first["status"] != STOPPED:
        return f"{len(failed)} failed; trial {first['trial']}: {first['error']}"
    period_s = arena.study(first["world"], first["d_ref_m"]).controller.sampling_time_s
    steps = round(arena.duration_s / period_s)
    return (
        f"trial {first['trial']} was stopped after {first['steps']:.0f} of {steps} steps, which "
        f"took {first['step_ms_median']:.0f} ms each; allowed is {arena.step_budget_ms:g} ms"
    )


def _step_ms(rows: pd.DataFrame) -> float | None:
    told = rows["step_ms_median"].astype(float)
    return None if told.isna().all() else float(told.median())


def _mean(values: pd.Series) -> float | None:
    return None if values.isna().all() else float(values.astype(float).mean())


def _rms(values: pd.Series) -> float | None:
    return None if values.isna().all() else math.sqrt((values.astype(float) ** 2).mean())


def is_flown(result: Result) -> bool:
    """Tell whether a controller really flies a cell.

    All its trials were flown to the end, none violates the clearance, and the mean d_T is d_ref.
    """
    whole = result["trials"] and not result["errors"] and not result["missing"]
    return bool(whole and not result["violations"] and result["flies_d_ref"])


def closest(results: Sequence[Result], world: str) -> dict[str, Result | None]:
    """Find the smallest d_ref that each controller really flies in a world; None if there is none.

    Controllers come from the one that flies closest, and tracks best there, to those that fly
    nothing.
    """
    here = [result for result in results if result["world"] == world]
    found: dict[str, Result | None] = dict.fromkeys(result["controller"] for result in here)
    for result in here:
        best = found[result["controller"]]
        if is_flown(result) and (best is None or result["d_ref_m"] < best["d_ref_m"]):
            found[result["controller"]] = result
    return dict(sorted(found.items(), key=lambda item: _place(item[1])))


def _place(result: Result | None) -> tuple[float, float]:
    if result is None:
        return math.inf, math.inf
    rms_m = result["radial_rms_settled_m"]
    return result["d_ref_m"], math.inf if rms_m is None else rms_m


def candidates(results: Sequence[Result], world: str) -> list[Result]:
    """List whom one can take in a world: who flies closest first, then who tracks best.

    Whoever flew fewer than `ENOUGH_TRIALS`, where others flew more, is left out.
    """
    most = max((result["trials"] for result in results if result["world"] == world), default=0)
    return [
        best
        for controller, best in closest(results, world).items()
        if best is not None
        and controller not in BEYOND_KNOWLEDGE
        and best["trials"] >= min(ENOUGH_TRIALS, most)
    ]
