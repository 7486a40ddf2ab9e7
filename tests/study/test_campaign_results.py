# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Rows are the flights of their seeds, and the summary is what the rows say."""

import json

import numpy as np
import pandas as pd
import pytest
from support.campaign_runs import without_times

from gtmr_model import Tower, Vehicle, airframe_clearance
from gtmr_nmpc import Controller
from gtmr_sim import FlightLog, fly
from gtmr_study.campaign import trial
from gtmr_study.campaign.study import Study
from gtmr_study.campaign.summary import (
    LEAST_TRIALS_FOR_SHARES,
    SHARE_HALF_WIDTH,
    channel_shares,
    summarise,
    wilson_interval,
)
from gtmr_study.campaign.trial import COLUMNS, QUANTILE_COLUMNS, fly_trial


@pytest.fixture
def summary(flown):
    return json.loads((flown / "summary.json").read_text())


def test_one_row_per_trial_and_mode_in_order(flown):
    trials = pd.read_csv(flown / "trials.csv")

    assert tuple(trials.columns) == COLUMNS
    assert list(zip(trials["trial"], trials["mode"], strict=True)) == [
        (k, mode) for k in range(6) for mode in ("nominal", "robust")
    ]
    assert (trials["status"] == "flown").all()


def test_modes_see_the_same_mismatch_and_the_same_seed(flown):
    trials = pd.read_csv(flown / "trials.csv").set_index(["trial", "mode"])
    given = trials[["seed", "mass", "J_x", "J_y", "J_z", "thrust", "drag", "w_bx", "w_by", "w_bz"]]

    nominal, robust = (given.xs(mode, level="mode") for mode in ("nominal", "robust"))

    pd.testing.assert_frame_equal(nominal, robust)
    assert nominal["seed"].is_unique


def test_modes_meet_the_same_gusts():
    scenario = Study(seed=5).scenario(0)

    gusts = [fly(scenario, Controller(mode=mode), 0.5).w_g for mode in ("nominal", "robust")]

    np.testing.assert_array_equal(*gusts)


def test_a_row_is_the_flight_of_its_seed(flown):
    row = pd.read_csv(flown / "trials.csv").iloc[3]
    scenario = Study(seed=5).scenario(1)

    log = fly(scenario, Controller(mode="robust"), 0.5)

    assert (row["trial"], row["mode"], row["seed"]) == (1, "robust", scenario.seed)
    assert row["min_clearance_m"] == pytest.approx(log.d_T.min(), abs=1e-6)
    assert row["residual_max_m"] == pytest.approx(0.2 - log.d_T.min(), abs=1e-6)
    airframe = airframe_clearance(log.x, Vehicle.paper(), Tower())
    assert row["min_airframe_clearance_m"] == pytest.approx(airframe.min(), abs=1e-6)


def test_a_trial_that_raises_is_reported_in_its_row(monkeypatch):
    def fails(*_):
        raise ArithmeticError("lost\nthe tower")

    monkeypatch.setattr(trial, "fly", fails)

    row = fly_trial(Study(), 3, "robust")

    assert (row["status"], row["error"]) == ("error", "ArithmeticError: lost the tower")
    assert row["seed"] == Study().scenario(3).seed
    assert row["min_clearance_m"] == ""


def test_a_flight_that_diverges_is_an_error_not_a_figure(monkeypatch):
    def diverges(scenario, controller, duration_s, period_s):
        log = fly(scenario, controller, duration_s, period_s)
        return FlightLog(**{**log.__dict__, "d_T": np.full_like(log.d_T, np.nan)})

    monkeypatch.setattr(trial, "fly", diverges)

    assert "not finite" in fly_trial(Study(duration_s=0.1), 0, "robust")["error"]


def test_every_summary_figure_is_recomputed_from_the_csv_by_plain_pandas(flown, summary):
    trials = pd.read_csv(flown / "trials.csv")
    assert set(summary) == {"nominal", "robust"}
    for mode, s in summary.items():
        rows = trials[(trials["mode"] == mode) & (trials["status"] == "flown")]
        pooled = rows[[c for c in rows if c.startswith("residual_") and c[9].isdigit()]].stack()
        assert s.pop("violation_rate_95") == list(
            wilson_interval(int(rows["violated"].sum()), len(rows))
        )
        assert s == {
            "trials": len(rows),
            "errors": 0,
            "violations": rows["violated"].sum(),
            "violation_rate": rows["violated"].mean(),
            "min_clearance_m": rows["min_clearance_m"].min(),
            "median_clearance_m": rows["d_min_m"].iloc[0] - pooled.quantile(0.5),
            "residual_m": {
                "min": rows["residual_min_m"].min(),
                "q1": pooled.quantile(0.25),
                "median": pooled.quantile(0.5),
                "q3": pooled.quantile(0.75),
                "max": rows["residual_max_m"].max(),
            },
            "radial_rms_m": (rows["radial_rms_m"] ** 2).mean() ** 0.5,
            "solve_ms": {
                "mean": rows["solve_ms_mean"].mean(),
                "median": rows["solve_ms_median"].median(),
                "p99": rows["solve_ms_p99"].median(),
            },
            "failed_steps": rows["failed_steps"].sum(),
            "violations_any_time": (rows["min_clearance_any_time_m"] < 0.2).sum(),
            "min_clearance_any_time_m": rows["min_clearance_any_time_m"].min(),
            "min_airframe_clearance_m": rows["min_airframe_clearance_m"].min(),
            "mean_clearance_m": rows["mean_clearance_m"].mean(),
            # These flights are over before they have settled.
            "radial_rms_settled_m": None,
        }
    again = json.loads((flown.parent / "s.json").read_text())
    assert without_times(again)["robust"]["trials"] == 6


def test_trials_that_raised_are_counted_apart(flown, tmp_path):
    trials = pd.read_csv(flown / "trials.csv")
    lost = pd.DataFrame([trial.empty_row(6, "robust") | {"status": "error", "error": "lost"}])
    both = tmp_path / "trials.csv"
    pd.concat([trials, lost]).to_csv(both, index=False)

    summed = summarise(pd.read_csv(both))

    assert summed["robust"]["trials"] == 6
    assert summed["robust"]["errors"] == 1
    assert summed["nominal"]["errors"] == 0


def test_percentiles_of_many_trials_stand_for_the_pooled_residual():
    """The stated accuracy of the quartiles: half a millimetre for the paper's 500 trials."""
    rng = np.random.default_rng(0)
    mean, spread = rng.normal(-0.15, 0.05, (500, 1)), rng.uniform(0.01, 0.1, (500, 1))
    phase = np.linspace(0.0, 6.0 * np.pi, 2000)
    residuals = mean + spread * np.sin(phase + rng.uniform(0.0, 6.0, (500, 1)))

    kept = np.percentile(residuals, trial.QUANTILES_PERCENT, axis=1)

    levels = (25, 50, 75)
    np.testing.assert_allclose(
        np.percentile(kept, levels), np.percentile(residuals, levels), atol=5e-4
    )
    assert len(QUANTILE_COLUMNS) == len(set(QUANTILE_COLUMNS)) == 20


@pytest.mark.parametrize(
    ("events", "trials", "low", "high"),
    # Newcombe, Statistics in Medicine 17 (1998), table I, method 3.
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_interval_is_that_of_the_literature(events, trials, low, high):
    assert wilson_interval(events, trials) == pytest.approx((low, high), abs=1e-4)


def additive(seed, n=500):
    """Trials whose least clearance is a sum of channels' effects with the variances given."""
    rng = np.random.default_rng(seed)
    zeta = rng.uniform(-1.0, 1.0, (n, 9))
    # Variance 1 each: linear, and towards or away, where it is the size that counts.
    effects = np.sqrt(3.0) * zeta
    effects[:, 6] = np.sqrt(12.0) * (np.abs(zeta[:, 6]) - 0.5)
    clearance = effects @ np.sqrt(0.01 * SHARES) + np.sqrt(0.01 * 0.05) * rng.normal(size=n)
    return pd.DataFrame(zeta, columns=COLUMNS[5:14]).assign(
        status="flown", min_clearance_m=clearance
    )


SHARES = np.array([0.3, 0.0, 0.0, 0.0, 0.1, 0.05, 0.5, 0.0, 0.0])


@pytest.mark.parametrize("seed", [1, 2])
def test_known_shares_are_recovered(seed):
    shares = channel_shares(additive(seed))

    assert list(shares.index[:4]) == ["w_bx", "mass", "thrust", "drag"]
    for name, known in zip(COLUMNS[5:14], SHARES, strict=True):
        share, low, high = shares.loc[name]
        assert share == pytest.approx(known, abs=SHARE_HALF_WIDTH), name
        assert 0.0 <= low <= share <= high <= 1.0, name


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 1000])
def test_intervals_of_shares_hold_as_often_as_they_say(first):
    held, widest = np.zeros(9), 0.0
    for seed in range(first, first + 100):
        shares = channel_shares(additive(seed, LEAST_TRIALS_FOR_SHARES)).loc[list(COLUMNS[5:14])]
        held += (shares["low"] <= SHARES) & (shares["high"] >= SHARES)
        widest = max(widest, (shares["high"] - shares["low"]).mean())

    assert held.min() >= 90
    assert widest <= 2.0 * SHARE_HALF_WIDTH


def test_a_channel_that_does_not_vary_has_no_share():
    assert "drag" not in channel_shares(additive(3).assign(drag=0.0)).index
