# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The active set ends within its bound on passes, and what it then returns can be flown."""

import importlib.util
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.compiled import codegen
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_sim import Scenario, Simulation

FEW = 3
"""A bound that hardly any QP with active inequalities is solved within."""
OVER_RAD = np.pi / 2
"""Pitch at which Euler angles have no rates, so that linearisations mean nothing."""


@pytest.fixture(scope="module")
def hard():
    """Load ``bench/passes.py``, which is no module of a package."""
    path = Path(__file__).parents[2] / "bench" / "passes.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def hurried(monkeypatch):
    """Make a problem, of another horizon than all others, whose solver stops after FEW passes."""
    flags = ("-O0", f"-DGTMR_MAX_PASSES={FEW}", "-DGTMR_MAX_GUESSES=0")
    monkeypatch.setattr(codegen, "WRITTEN_FLAGS", flags)
    monkeypatch.setattr(codegen, "GENERATED_FLAGS", ("-O0",))
    return ControllerConfig(horizon=19)


def beyond_limits(vehicle, plan, xi):
    """How far a plan is beyond rotor limits [Hz/s, Hz], less what it takes to return."""
    stages = np.arange(1, len(plan.u_plan) + 1)[:, None]
    reach = vehicle.max_rotor_acceleration_hz_s * 0.025 * stages
    lowest = np.minimum(vehicle.min_rotor_speed_hz, xi + reach)
    highest = np.maximum(vehicle.max_rotor_speed_hz, xi - reach)
    return max(
        np.abs(plan.u_plan).max() - vehicle.max_rotor_acceleration_hz_s,
        (lowest - plan.x_plan[1:, 12:]).max(),
        (plan.x_plan[1:, 12:] - highest).max(),
    )


def test_hard_random_qps_are_solved_with_passes_to_spare(hard):
    qps, vehicle, statuses, most = hard.HardQps(), ControllerConfig().vehicle, Counter(), 0
    for number in range(500):
        for qp in qps.from_start(number):
            statuses[qp.result.status] += 1
            if qp.result.status == "limited":
                # Its linearisation, not the bound, stood in the way.
                assert np.abs(qp.result.x_plan[:, 4]).max() > OVER_RAD
            else:
                most = max(most, qp.passes)
            if qp.result.status != "failed":
                assert beyond_limits(vehicle, qp.result, qp.xi) < 1e-6
    assert statuses["solved"] + statuses["softened"] > 1990
    assert 50 < most < hard.MAX_PASSES / 2


@pytest.mark.parametrize("number", [2134, 8616, 9622, 171220])
def test_clearances_that_are_all_at_their_cap_do_not_go_round_in_circles(hard, number):
    qps = list(hard.HardQps().from_start(number))
    assert {qp.result.status for qp in qps} <= {"solved", "softened"}
    # The step after a cold start, whose slack was large; where they change sides one by one, 753.
    assert qps[1].passes < 18


@pytest.mark.parametrize("mode", ["nominal", "robust"])
def test_a_step_that_is_stopped_returns_a_plan_within_the_limits_of_the_rotors(
    hard, hurried, mode
):
    rng, statuses = np.random.default_rng(1), Counter()
    hover = hurried.helix.initial_state(hurried.tower, hurried.vehicle)
    iteration = CompiledIteration(hurried)
    for _ in range(100):
        controller, x = Controller(hurried, mode, iteration), hover.copy()
        x[:12] += 0.5 * rng.uniform(hard.LOW, hard.HIGH)
        x[12:] = rng.uniform(*hard.ROTORS_HZ, 6)
        for k in range(3):
            plan = controller.step(0.025 * k, x)
            statuses[plan.status] += 1
            assert iteration.passes <= FEW
            assert np.isfinite(plan.x_plan).all()
            assert beyond_limits(hurried.vehicle, plan, x[12:]) < 1e-9
            tightened = hurried.tower.residual(plan.x_plan) + plan.alpha_p + plan.alpha_g
            # The rest is the tower's curvature along the step.
            open_m = np.maximum(tightened, 0.0)
            assert np.abs(plan.slack - open_m)[:5].max() < 0.03
            x = plan.x_plan[1]
    assert statuses["failed"] == 0
    assert statuses["limited"] > 100


def test_a_flight_of_stopped_steps_recovers(hurried):
    simulation = Simulation(Scenario(guard="hold"), 0.025)
    x = simulation.x.copy()
    x[0] -= 0.2
    x[6:9] = [-0.4, 0.2, 0.1]
    x[12:] += [-25.0, 25.0, 10.0, -10.0, 20.0, -20.0]
    simulation.plant.x = x
    controller, statuses = Controller(hurried), []
    for _ in range(120):
        t, x = simulation.time_s, simulation.x
        plan = controller.step(t, x)
        statuses.append(plan.status)
        simulation.command(t, plan.u_plan)
        simulation.advance(0.025)
    assert statuses[0] == "limited"
    assert "failed" not in statuses
    assert set(statuses[-20:]) == {"solved"}
    assert hurried.tower.clearance(simulation.x[None])[0] > hurried.tower.min_clearance_m
