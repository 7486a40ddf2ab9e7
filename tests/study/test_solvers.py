# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""QP solvers are given the QPs that the controller solved, and solve them."""

from dataclasses import replace
from functools import cache

import pytest

from gtmr_nmpc import ControllerConfig
from gtmr_study.solvers.bench import make_qp_rivals
from gtmr_study.solvers.daqp import DaqpRival
from gtmr_study.solvers.qp import MODES, record_steps, time_qp_rivals
from gtmr_study.solvers.situations import record_situations

STEPS = 80
"""Of each situation: two starts in ``recovery``."""


@cache
def situations():
    return record_situations(STEPS)


@cache
def make_solvers():
    return make_qp_rivals(ControllerConfig())


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_qp_solvers_find_the_input_of_the_controller(mode):
    pytest.importorskip("piqp")
    solvers = make_solvers()
    assert set(solvers) == {"DAQP", "PIQP"}

    for situation in situations():
        figures = time_qp_rivals(situation, mode, STEPS, solvers)

        for name in solvers:
            assert figures[name]["gave up"] == 0, (situation.name, name)
            # Inputs go up to 200 Hz/s.
            assert figures[name]["difference"] < 1e-2, (situation.name, name)
            assert 0.0 < figures[name]["median"] <= figures[name]["p99.9"]


def test_a_solver_of_another_qp_is_noticed():
    class WithoutMargins(DaqpRival):
        def solve(self, step):
            return super().solve(replace(step, mode="nominal"))

    solvers = {"another": WithoutMargins(ControllerConfig())}

    figures = time_qp_rivals(situations()[2], "robust", STEPS, solvers)

    assert figures["another"]["difference"] > 1.0


def test_a_solver_that_gives_up_is_counted():
    class Never:
        started = 0

        def start(self):
            self.started += 1

        def solve(self, step):
            if step.t > 0.0:
                raise RuntimeError("gave up")
            assert self.started > 0
            return step.solution.u, 1e-3

    recovery = situations()[2]

    figures = time_qp_rivals(recovery, "nominal", STEPS, {"never": Never()})

    starts = sum(t == 0.0 for t, _ in recovery.steps)
    assert starts == 2
    assert figures["never"]["gave up"] == STEPS - starts


def test_recorded_qps_are_those_where_constraints_and_slacks_matter():
    limit, recovery = (
        record_steps(situation, ControllerConfig(), "robust") for situation in situations()[1:]
    )

    assert any(step.solution.status == "softened" for step in recovery)
    assert any(step.solution.tightening.total.max() > 0.0 for step in limit)
