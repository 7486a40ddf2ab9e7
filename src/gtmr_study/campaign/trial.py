# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""One trial in one mode: a flight boiled down to a row of trials.csv."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gtmr_model import CHANNELS
from gtmr_nmpc import Controller
from gtmr_sim import FlightLog, StepController, fly
from gtmr_study.campaign.study import Study
from gtmr_study.own_controller import OwnController
from gtmr_study.result_files import one_line

Row = dict[str, Any]

FLOWN, ERROR = "flown", "error"
"""What the status of a trial can be."""
QUANTILES_PERCENT = tuple(2.5 + 5.0 * k for k in range(20))
"""Which percentiles of a trial's residual a row keeps: the middles of twenty equal parts, so that
those of all trials together are a sample of the residual pooled over all trials."""
QUANTILE_COLUMNS = tuple(f"residual_{percent:04.1f}_m" for percent in QUANTILES_PERCENT)
ADDED_COLUMNS = (
    "min_clearance_any_time_m",
    "violated_any_time",
    "mean_clearance_m",
    "radial_rms_settled_m",
    "min_airframe_clearance_m",
)
"""Columns that campaigns of before do not have: of every plant step instead of every sampling
time, of d_T - d_ref from `SETTLED_S` on, empty for flights that end before, and of the airframe,
the nearest rotor disc."""
COLUMNS = (
    "trial",
    "mode",
    "seed",
    "status",
    "error",
    *CHANNELS,
    "d_min_m",
    "min_clearance_m",
    "violated",
    "residual_min_m",
    *QUANTILE_COLUMNS,
    "residual_max_m",
    "radial_rms_m",
    *ADDED_COLUMNS,
    "max_slack_m",
    "failed_steps",
    "solve_ms_mean",
    "solve_ms_median",
    "solve_ms_p99",
)
"""Columns of trials.csv; lengths are rounded to 1e-6 m, percentiles to 1e-4 m. ``max_slack_m`` and
``failed_steps`` are empty for a controller that does not tell."""
FIRST_COLUMNS = tuple(name for name in COLUMNS if name not in ADDED_COLUMNS)
"""Columns that trials.csv always had."""
SETTLED_S = 5.0
"""When the start of a flight is over [s]."""


def fly_trials(
    study: Study, flights: Sequence[tuple[int, str]], own: OwnController | None = None
) -> list[Row]:
    """Fly a chunk of a study, numbers of trials and modes; this is what a worker runs."""
    return [fly_trial(study, trial, mode, own) for trial, mode in flights]


def fly_trial(study: Study, trial: int, mode: str, own: OwnController | None = None) -> Row:
    """Fly one trial in one mode, or with an own controller, whose class ``mode`` then names.

    The row's status is ``error`` if the flight raised, and the row says why.
    """
    row = empty_row(trial, mode)
    try:
        scenario = study.against(mode).scenario(trial)
        zeta = np.round(scenario.zeta_array, 6).tolist()
        row.update(seed=scenario.seed, **dict(zip(CHANNELS, zeta, strict=True)))
        controller: StepController = (
            Controller(study.controller, mode)  # type: ignore[arg-type]
            if own is None
            else own.make(study.controller)
        )
        log = fly(scenario, controller, study.duration_s, study.controller.sampling_time_s)
        row.update(status=FLOWN, **flight_figures(log))
    except Exception as error:
        # Whatever goes wrong in one of many trials belongs into its row, not to the campaign.
        row.update(status=ERROR, error=one_line(error))
    return row


def empty_row(trial: int, mode: str) -> Row:
    """Make a row that says nothing yet but whose it is."""
    return {**dict.fromkeys(COLUMNS, ""), "trial": trial, "mode": mode}


def flight_figures(log: FlightLog) -> Row:
    """Give the figures of a flight, by column; ValueError if it diverged."""
    scenario, tower = log.scenario, log.scenario.tower
    off_reference_m = log.d_T - scenario.helix.clearance(log.t, tower)
    residual = tower.min_clearance_m - log.d_T
    if not (np.isfinite(residual).all() and np.isfinite(log.least_clearance_m)):
        raise ValueError("the flight diverged: its clearance is not finite")
    highest = float(residual.max())
    percentiles = np.round(np.percentile(residual, QUANTILES_PERCENT), 4).tolist()
    settled = off_reference_m[log.t >= SETTLED_S]
    median_ms, p99_ms = np.percentile(log.solve_ms, (50, 99))
    return {
        "d_min_m": tower.min_clearance_m,
        "min_clearance_m": round(float(log.d_T.min()), 6),
        "violated": highest > 0.0,
        "residual_min_m": round(float(residual.min()), 6),
        **dict(zip(QUANTILE_COLUMNS, percentiles, strict=True)),
        "residual_max_m": round(highest, 6),
        "radial_rms_m": round(_rms(off_reference_m), 6),
        # None leaves the cell empty.
        "max_slack_m": None if log.max_slack_m is None else round(log.max_slack_m, 6),
        "failed_steps": log.failed_steps,
        "solve_ms_mean": round(float(log.solve_ms.mean()), 4),
        "solve_ms_median": round(float(median_ms), 4),
        "solve_ms_p99": round(float(p99_ms), 4),
        "min_clearance_any_time_m": round(log.least_clearance_m, 6),
        "violated_any_time": log.least_clearance_m < tower.min_clearance_m,
        "mean_clearance_m": round(float(log.d_T.mean()), 6),
        "radial_rms_settled_m": round(_rms(settled), 6) if settled.size else None,
        "min_airframe_clearance_m": round(float(log.d_airframe.min()), 6),
    }


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))
