# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""RTI iterated to convergence solves the NLP that the paper writes down."""

from functools import cache

import numpy as np
import pytest

from gtmr_nmpc import ControllerConfig
from gtmr_nmpc.reference.rti import RealTimeIteration, Trajectory
from gtmr_study.solvers.nlp import InspectionNlp

IPOPT = {
    "ipopt.tol": 1e-12,
    "ipopt.bound_relax_factor": 0.0,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "print_time": False,
}

CASES = {
    "calm": (0.0, 0.0),
    "touching": (-0.05, -0.3),
    "infeasible start": (-0.2, 0.0),
}
"""Offset [m] and speed [m/s] along the radius at the start."""


@cache
def nlp(config, margins_given):
    """Write down the problem and differentiate it twice, which is most of the work, once."""
    return InspectionNlp(config, "ipopt", IPOPT, margins_given)


@cache
def iteration(config):
    return RealTimeIteration(config)


def converged(config, mode, x0, rti=None):
    """Iterate prepare and feedback on one problem until the inputs stand still."""
    rti = rti or iteration(config)
    iterate = Trajectory(
        np.tile(x0, (config.horizon + 1, 1)), np.zeros((config.horizon, len(x0) - 12))
    )
    for _ in range(100):
        new, slack = rti.feedback(rti.prepare(0.0, iterate, mode), x0)
        change = np.abs(new.u - iterate.u).max()
        iterate = new
        if change < 1e-9:
            return iterate, slack, rti.prepare(0.0, iterate, mode)
    pytest.fail(f"inputs still change by {change} Hz/s after 100 iterations")


def start(config, offset_m, radial_m_s):
    """Start on the helix, moved and sped up along the radius, slightly rolled."""
    x0 = config.helix.initial_state(config.tower, config.vehicle)
    x0[0] += offset_m
    x0[6] += radial_m_s
    x0[3] += 0.05
    return x0


def assert_case_is(case, config, iterate, slack, prep):
    """The case exercises what its name says."""
    residual = (config.tower.residual(iterate.x) + prep.margins.total)[1:]
    assert (residual.max() > -1e-7) == (case != "calm")
    assert (slack.max() > 1e-6) == (case == "infeasible start")


def assert_same_solution(iterate, slack, reference):
    np.testing.assert_allclose(iterate.u[0], reference.u[0], atol=1e-6)
    np.testing.assert_allclose(iterate.x, reference.x, atol=1e-6)
    np.testing.assert_allclose(slack, reference.slack, atol=1e-6)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("mode", ["nominal", "robust"])
def test_converged_rti_with_frozen_margins_is_the_nlp_with_those_margins(mode, case):
    config = ControllerConfig()
    x0 = start(config, *CASES[case])
    iterate, slack, prep = converged(config, mode, x0)
    assert_case_is(case, config, iterate, slack, prep)
    reference = nlp(config, True).solve(0.0, x0, prep.margins.total, None)
    assert_same_solution(iterate, slack, reference)


def test_converged_rti_with_disturbances_is_the_nlp_with_them():
    config = ControllerConfig()
    x0 = start(config, *CASES["touching"])
    theta = np.array([-0.6, 0.4, 0.9, -0.5, 0.2, 0.1, 0.05, -0.08, 0.03])
    decay = np.exp(-0.025 / config.offset_free.disturbance.gust_time_s) ** np.arange(20)
    force = theta[:3] + decay[:, None] * theta[3:6]
    disturbance = np.hstack([force, np.tile(theta[6:], (20, 1))])
    disturbed = RealTimeIteration(config)
    disturbed.disturb(theta)
    calm = converged(config, "robust", x0)[0]
    iterate, slack, prep = converged(config, "robust", x0, disturbed)
    assert np.abs(iterate.u[0] - calm.u[0]).max() > 1.0
    assert_case_is("touching", config, iterate, slack, prep)
    reference = InspectionNlp(config, "ipopt", IPOPT, True, disturbance=disturbance)
    solution = reference.solve(0.0, x0, prep.margins.total, None)
    assert_same_solution(iterate, slack, solution)


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("case", CASES)
def test_converged_rti_with_margin_gradient_is_eq_15(case):
    # Few, longer stages: IPOPT differentiates Pi twice, which takes a minute at N = 20.
    config = ControllerConfig(tightening="gradient", horizon=5, sampling_time_s=0.08)
    x0 = start(config, *CASES[case])
    iterate, slack, prep = converged(config, "robust", x0)
    assert_case_is(case, config, iterate, slack, prep)
    frozen, *_ = converged(config.model_copy(update={"tightening": "frozen"}), "robust", x0)
    if case == "touching":
        assert np.abs(frozen.u[0] - iterate.u[0]).max() > 1.0
    reference = nlp(config, False).solve(0.0, x0, None, None)
    assert_same_solution(iterate, slack, reference)
