# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""The reproduction sets ours beside the paper's, honestly, and its searches go on."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.margins import gust_margin
from gtmr_sim import fly
from gtmr_study import first_order
from gtmr_study.calibration import SPACE, calibrate, candidate, defaults
from gtmr_study.margin_budget import margin_budget, unit_slips
from gtmr_study.paper_claims import PAPER, deviations, distance
from gtmr_study.paper_figures import table_ii_rows
from gtmr_study.reproduce import REPORT_FILE, RESULTS_FILE, Effort, reproduce
from gtmr_study.study import Study
from gtmr_study.summary import summarise

CONFIG = ControllerConfig()
SHORT = Effort(trials=2, duration_s=1.5, quality_duration_s=1.5, variant_trials=0)
COMMITTED = Path(__file__).parents[1] / "docs" / "reproduction"


def paper_summary():
    return {
        mode: {
            "trials": 500,
            "violations": row.violations,
            "min_clearance_m": row.min_clearance_m,
            "residual_m": dict(row.residual_m),
            "solve_ms": {"mean": row.solve_ms},
        }
        for mode, row in PAPER.items()
    }


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reproduction")
    return folder, reproduce(Study(seed=2), SHORT, folder, n_workers=2)


def test_table_and_figures_are_there_as_png_and_pdf(reproduced):
    folder, results = reproduced

    for name in ("table-ii", "fig-1", "fig-2", "first-order", "residual", "channels"):
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    assert json.loads((folder / RESULTS_FILE).read_text()) == json.loads(json.dumps(results))


def test_the_report_needs_nothing_else_and_names_the_paper(reproduced):
    text = (reproduced[0] / REPORT_FILE).read_text(encoding="utf-8")

    for name in ("table-ii", "fig-1", "fig-2", "first-order"):
        assert f'<figure id="{name}"><svg' in text
    assert "<script" not in text
    assert "src=" not in text.replace('xlink:href="data:', "")
    assert "paper" in text


def test_started_again_it_comes_to_the_same(reproduced):
    folder, results = reproduced

    again = reproduce(Study(seed=2), SHORT, folder, n_workers=1)

    assert again["summary"] == results["summary"]
    assert again["first_order"] == results["first_order"]


def test_the_paper_is_at_distance_zero_of_itself():
    assert distance(paper_summary(), ("nominal", "robust")) == 0.0


def test_distance_counts_in_tolerances():
    ours = paper_summary()
    ours["nominal"]["violations"] = 270
    ours["nominal"]["residual_m"]["q1"] += 0.04

    off = deviations(ours["nominal"], "nominal")

    assert off["violations"] == pytest.approx(1.0)
    assert off["residual_q1"] == pytest.approx(2.0)
    assert distance(ours, ("nominal",)) == pytest.approx(math.sqrt(5.0 / len(off)))


def test_the_paper_contradicts_itself_on_the_robust_clearance():
    """Three quarters of the robust samples are below q3, so a quarter is closer than 0.36 m."""
    robust, d_min = PAPER["robust"], CONFIG.tower.min_clearance_m

    assert d_min - robust.residual_m["max"] == pytest.approx(0.314)
    assert d_min - robust.residual_m["q3"] == pytest.approx(0.36)
    assert robust.min_clearance_m > d_min - robust.residual_m["q3"]
    nominal = PAPER["nominal"]
    assert d_min - nominal.residual_m["max"] == pytest.approx(nominal.min_clearance_m)


def test_table_ii_puts_the_paper_beside_ours():
    rows = table_ii_rows(paper_summary())

    assert rows[0] == ("nominal, paper", "0.182 m", "230/500", "9.4 ms")
    assert [row[0] for row in rows[1:]] == ["nominal, here", "robust, paper", "robust, here"]


def test_perturbations_are_those_of_the_simulated_world():
    """Against the plant itself, with its own finer steps, over the first horizon of a flight."""
    study = Study(duration_s=1.5, seed=3)
    scenario, config = study.scenario(0), study.controller
    found = first_order.perturbations(study, [0])
    plans = []

    class Held:
        def __init__(self):
            self._controller, self._plan = Controller(config), None

        def step(self, t, x):
            if self._plan is None or round(t / config.sampling_time_s) <= 20:
                self._plan = self._controller.step(t, x)
                plans.append((x, self._plan))
            return self._plan

    class Kept(Held):
        """Plans once more at step 20 and plays that plan to its end."""

        def step(self, t, x):
            solution = super().step(t, x)
            if len(plans) <= 20:
                return solution
            k = round(t / config.sampling_time_s) - 20
            u = np.vstack([solution.u_plan[k:], np.zeros((k, 6))])
            return type(solution)(**{**solution.__dict__, "u_plan": u})

    log = fly(scenario, Kept(), 1.025)
    x0, plan = plans[20]
    residual = config.tower.residual(log.x[20:41])
    undisturbed = first_order._residual(
        config.vehicle, config.tower, 0.025, x0[None], plan.u_plan[None], np.zeros(9), np.zeros(3)
    )[0]
    np.testing.assert_allclose(found.both[0], residual - undisturbed, atol=1e-6)


def test_gusts_never_exceed_their_margin_and_the_worst_case_uses_most_of_it():
    """eq. (13) divides by the least mass; the model that plans has the nominal one: 0.9."""
    found = first_order.quality(first_order.perturbations(Study(duration_s=2.0), range(3)))

    assert max(found["gust"]["exceeded"]) == 0.0
    assert found["worst_gust"]["median"][0] == pytest.approx(0.9, abs=0.01)
    assert max(found["worst_gust"]["max"]) < 1.0


def test_first_order_misses_what_grows_with_the_inverse_of_the_mass():
    """Force over (1 - 0.1) m0 is 11 % more than first order in the mass says."""
    found = first_order.quality(first_order.perturbations(Study(duration_s=2.0), range(5)))

    assert max(found["parametric"]["exceeded"]) == 0.0
    assert found["worst_parametric"]["median"][0] == pytest.approx(1.0 / 0.9, abs=0.01)


def test_the_margin_budget_is_that_of_the_formulas():
    """Wind alone, double integrated: 1/2 w/m T^2, times the mean of |cos| over a turn."""
    budget = margin_budget(CONFIG)
    time_s = CONFIG.horizon * CONFIG.sampling_time_s
    bound, mass = CONFIG.uncertainty.wind_bias_n[0], CONFIG.vehicle.mass_kg

    wind = 0.5 * bound / mass * time_s**2 * 2.0 / np.pi
    assert budget["w_bx"] == pytest.approx(wind, rel=0.01)
    gust = gust_margin(CONFIG.uncertainty, CONFIG.vehicle, CONFIG.horizon, CONFIG.sampling_time_s)
    assert budget["gust"] == pytest.approx(gust[-1])
    assert budget["total"] == pytest.approx(sum(v for k, v in budget.items() if k != "total"))


def test_a_wind_bias_taken_for_an_acceleration_is_larger_by_the_mass():
    slip = unit_slips(CONFIG)["wind bias in m/s² instead of N"]

    ratio = margin_budget(slip)["w_bx"] / margin_budget(CONFIG)["w_bx"]

    assert ratio == pytest.approx(CONFIG.vehicle.mass_kg, rel=0.01)


def test_a_candidate_of_the_defaults_is_the_default():
    base = Study()

    assert (
        candidate(defaults(base), base).controller.model_copy(
            update={"slack_l2": base.controller.slack_l2}
        )
        == base.controller
    )
    assert set(defaults(base)) == set(SPACE)


def test_an_interrupted_search_goes_on_as_if_it_had_not_been(tmp_path, monkeypatch):
    # Values that are compiled in would make a new controller for every evaluation.
    kept = ("rotor_acceleration_weight", "gust_std_n", "eps_s_m")
    for name in set(SPACE) - set(kept):
        monkeypatch.delitem(SPACE, name)
    base = Study(trials=1, duration_s=0.3, seed=4)

    whole = calibrate(base, "both", 3, tmp_path / "whole", 1)
    calibrate(base, "both", 1, tmp_path / "part", 1)
    part = calibrate(base, "both", 3, tmp_path / "part", 1)

    assert (part["parameters"], part["distance"]) == (whole["parameters"], whole["distance"])
    assert part["evaluations"] == 3
    assert set(part["deviations"]) == {"nominal", "robust"}


@pytest.mark.parametrize("name", ["default", "paper-closest"])
def test_the_committed_summary_is_that_of_the_committed_trials(name):
    trials = pd.read_csv(COMMITTED / name / "trials.csv.gz")
    results = json.loads((COMMITTED / name / RESULTS_FILE).read_text())

    assert summarise(trials) == results["summary"]
    assert results["summary"]["robust"]["trials"] == 500
    assert results["summary"]["robust"]["violations"] == 0


def test_the_closest_preset_matches_the_nominal_row():
    summary = json.loads((COMMITTED / "paper-closest" / RESULTS_FILE).read_text())["summary"]
    nominal = deviations(summary["nominal"], "nominal")

    for key in ("violations", "min_clearance", "residual_q1", "residual_median", "residual_q3"):
        assert abs(nominal[key]) <= 1.0, key
