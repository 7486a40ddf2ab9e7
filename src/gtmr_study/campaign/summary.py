# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The figures of a campaign, each from trials.csv alone (Table II, Fig. 2)."""

import math
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gtmr_model import CHANNELS
from gtmr_study.campaign.study import mode_order
from gtmr_study.campaign.trial import ADDED_COLUMNS, FLOWN, QUANTILE_COLUMNS

CONFIDENCE_Z = 1.959964
"""Quantile of the normal distribution for intervals of 95 % [-]."""
GROUPS = 16
"""Into how many groups of equal size a channel's values are sorted for its share of variance; of
an effect that is linear they see 1 - 1 / GROUPS^2."""
SHARE_HALF_WIDTH = 0.1
"""Half the interval of a share that is drawn, at most [-]."""
LEAST_TRIALS_FOR_SHARES = math.ceil(16.0 / 27.0 * (CONFIDENCE_Z / SHARE_HALF_WIDTH) ** 2)
"""Trials a mode from which `channel_shares` are shown. A share R^2 has a variance of about
4 R^2 (1 - R^2)^2 / n (Wishart 1931), at most 16 / (27 n), where R^2 = 1/3."""


def summarise(trials: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Boil a campaign down to its figures, a mode at a time.

    By mode: ``trials`` flown, ``errors``, ``violations``, the rate and its 95 % interval, the
    least clearance of any trial, the residual pooled over all instants of all trials
    (``residual_m``; its quartiles from the percentiles that every row keeps), the clearance at its
    median, the root mean square of d_T - d_ref over all instants, and solve times (mean over all
    steps; medians over the trials of a trial's median and 99th percentile). Of every plant step
    are ``violations_any_time`` and ``min_clearance_any_time_m``, of the time after the start
    ``radial_rms_settled_m``; a campaign of before tells none of these, nor ``mean_clearance_m``,
    nor ``min_airframe_clearance_m``, the least clearance of a rotor disc.
    """
    return {
        mode: _summary(trials[trials["mode"] == mode])
        for mode in sorted(trials["mode"].unique(), key=mode_order)
    }


def _summary(trials: pd.DataFrame) -> dict[str, Any]:
    flown = trials[trials["status"] == FLOWN]
    n, errors = len(flown), int((trials["status"] != FLOWN).sum())
    if n == 0:
        return {"trials": 0, "errors": errors, "violations": 0}
    violations = int(flown["violated"].astype(bool).sum())
    pooled = flown[list(QUANTILE_COLUMNS)].stack()
    median = float(pooled.quantile(0.5))
    failed = flown["failed_steps"]
    return {
        "trials": n,
        "errors": errors,
        "violations": violations,
        "violation_rate": violations / n,
        "violation_rate_95": list(wilson_interval(violations, n)),
        "min_clearance_m": float(flown["min_clearance_m"].min()),
        "median_clearance_m": float(flown["d_min_m"].iloc[0]) - median,
        "residual_m": {
            "min": float(flown["residual_min_m"].min()),
            "q1": float(pooled.quantile(0.25)),
            "median": median,
            "q3": float(pooled.quantile(0.75)),
            "max": float(flown["residual_max_m"].max()),
        },
        "radial_rms_m": math.sqrt((flown["radial_rms_m"] ** 2).mean()),
        "solve_ms": {
            "mean": float(flown["solve_ms_mean"].mean()),
            "median": float(flown["solve_ms_median"].median()),
            "p99": float(flown["solve_ms_p99"].median()),
        },
        # Not every controller tells.
        "failed_steps": None if failed.isna().all() else int(failed.sum()),
        **_any_time(flown.reindex(columns=list(ADDED_COLUMNS))),
    }


def _any_time(flown: pd.DataFrame) -> dict[str, Any]:
    if flown["min_clearance_any_time_m"].isna().all():
        return {}
    settled = flown["radial_rms_settled_m"].astype(float)
    return {
        "violations_any_time": int(flown["violated_any_time"].astype(bool).sum()),
        "min_clearance_any_time_m": float(flown["min_clearance_any_time_m"].min()),
        "mean_clearance_m": float(flown["mean_clearance_m"].mean()),
        # No flight may be long enough.
        "min_airframe_clearance_m": float(flown["min_airframe_clearance_m"].min()),
        "radial_rms_settled_m": (None if settled.isna().all() else math.sqrt((settled**2).mean())),
    }


def wilson_interval(events: int, trials: int) -> tuple[float, float]:
    """Bounds of an event's rate with 95 % confidence (Wilson 1927); 0 and 1 without trials."""
    if trials == 0:
        return 0.0, 1.0
    z, rate = CONFIDENCE_Z, events / trials
    centre = rate + z**2 / (2 * trials)
    spread = z * math.sqrt(rate * (1.0 - rate) / trials + (z / (2 * trials)) ** 2)
    scale = 1.0 + z**2 / trials
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)


def channel_shares(trials: pd.DataFrame) -> pd.DataFrame:
    """Find which channel of zeta drives the least clearance: its share of the variance, alone.

    Trials are sorted by a channel's value into groups of equal size; the share is the variance of
    the groups' means over the whole variance, corrected for chance (epsilon squared, Kelley 1935).
    It sees effects that are not monotonic, as that of a wind that pushes the vehicle to the tower
    on one side and away from it on the other. What the shares leave to 1 is interplay of channels,
    and gusts.

    By channel that varies, largest first: ``share`` and its 95 % interval by the jackknife (Efron
    1981), ``low`` and ``high``, all from 0 to 1 [-].
    """
    flown = trials[trials["status"] == FLOWN]
    clearance = flown["min_clearance_m"].to_numpy(float)
    found = {}
    for name in CHANNELS:
        share = _share(flown[name].astype(float), clearance)
        if share is not None:
            found[name] = np.clip(share, 0.0, 1.0)
    shares = pd.DataFrame.from_dict(found, orient="index", columns=["share", "low", "high"])
    return shares.sort_values("share", ascending=False)


def _share(channel: pd.Series, y: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """Epsilon squared of one channel, and the bounds of its interval; None if it has none."""
    if channel.nunique() > GROUPS:
        channel = pd.qcut(channel.rank(method="first"), GROUPS, labels=False)
    group = np.unique(channel, return_inverse=True)[1]
    n, size = len(y), np.bincount(group)
    off, off_group = y - y.mean(), y - (np.bincount(group, y) / size)[group]
    total, within = off @ off, off_group @ off_group
    if len(size) < 2 or n <= len(size) + 1 or total == 0.0:
        return None
    share = 1.0 - within / (n - len(size)) * (n - 1) / total
    # The same without each trial in turn; a trial that is alone in its group takes that along.
    alone = size[group] == 1
    with np.errstate(divide="ignore", invalid="ignore"):
        total = total - off**2 * n / (n - 1)
        within = within - np.where(alone, 0.0, off_group**2 * size[group] / (size[group] - 1))
        without = 1.0 - within / (n - 1 - len(size) + alone) * (n - 2) / total
    half_width = CONFIDENCE_Z * math.sqrt((n - 1) * without.var())
    return share, share - half_width, share + half_width
