# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The figures of a campaign, each from trials.csv alone (Table II, Fig. 2)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from gtmr_model import CHANNELS
from gtmr_nmpc import MODES
from gtmr_study.campaign.trial import FLOWN, QUANTILE_COLUMNS

CONFIDENCE_Z = 1.959964
"""Quantile of the normal distribution for intervals of 95 % [-]."""
GROUPS = 8
"""Into how many groups of equal size a channel's values are sorted for its share of variance."""


def summarise(trials: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Boil a campaign down to its figures, a mode at a time.

    Parameters
    ----------
    trials : pandas.DataFrame
        The rows of trials.csv.

    Returns
    -------
    dict
        By mode: ``trials`` flown, ``errors``, ``violations``, the rate and its 95 % interval, the
        least clearance of any trial, the residual pooled over all instants of all trials
        (``residual_m``; its quartiles from the percentiles that every row keeps), the clearance at
        its median, the root mean square of d_T - d_ref over all instants, and solve times (mean
        over all steps; medians over the trials of a trial's median and 99th percentile).
    """
    return {
        mode: _summary(trials[trials["mode"] == mode])
        for mode in MODES
        if (trials["mode"] == mode).any()
    }


def _summary(trials: pd.DataFrame) -> dict[str, Any]:
    flown = trials[trials["status"] == FLOWN]
    n, errors = len(flown), int((trials["status"] != FLOWN).sum())
    if n == 0:
        return {"trials": 0, "errors": errors, "violations": 0}
    violations = int(flown["violated"].astype(bool).sum())
    pooled = flown[list(QUANTILE_COLUMNS)].stack()
    median = float(pooled.quantile(0.5))
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
        "failed_steps": int(flown["failed_steps"].sum()),
    }


def wilson_interval(events: int, trials: int) -> tuple[float, float]:
    """Interval that holds the true rate of an event with 95 % confidence (Wilson 1927).

    Parameters
    ----------
    events : int
        How often it happened.
    trials : int
        Of how many.

    Returns
    -------
    tuple of float
        Lower and upper bound of the rate; 0 and 1 without trials.
    """
    if trials == 0:
        return 0.0, 1.0
    z, rate = CONFIDENCE_Z, events / trials
    centre = rate + z**2 / (2 * trials)
    spread = z * math.sqrt(rate * (1.0 - rate) / trials + (z / (2 * trials)) ** 2)
    scale = 1.0 + z**2 / trials
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)


def channel_shares(trials: pd.DataFrame) -> pd.Series:
    """Which channel of zeta drives the least clearance: its share of the variance, alone.

    Trials are sorted by a channel's value into groups of equal size; the share is the variance of
    the groups' means over the whole variance, corrected for chance (epsilon squared, Kelley 1935).
    It sees effects that are not monotonic, as that of a wind that pushes the vehicle to the tower
    on one side and away from it on the other. What the shares leave to 1 is interplay of channels,
    and gusts.

    Parameters
    ----------
    trials : pandas.DataFrame
        Rows of one mode.

    Returns
    -------
    pandas.Series
        Share by channel [-], falling; at least 0. NaN where a channel does not vary.
    """
    flown = trials[trials["status"] == FLOWN]
    clearance = flown["min_clearance_m"].astype(float)
    shares = {name: _share(flown[name].astype(float), clearance) for name in CHANNELS}
    return pd.Series(shares).sort_values(ascending=False)


def _share(channel: pd.Series, clearance: pd.Series) -> float:
    n, total = len(clearance), float(((clearance - clearance.mean()) ** 2).sum())
    if channel.nunique() <= GROUPS:
        groups = channel
    else:
        groups = pd.qcut(channel.rank(method="first"), GROUPS, labels=False)
    count = groups.nunique()
    if count < 2 or n <= count or total == 0.0:
        return np.nan
    means = clearance.groupby(groups).transform("mean")
    within = float(((clearance - means) ** 2).sum())
    return max(0.0, 1.0 - (within / (n - count)) / (total / (n - 1)))
