# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The controller in C solves the same QPs as the one in NumPy, whose solver is exchanged too."""

import os
from collections import Counter

import casadi as ca
import numpy as np
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st
from support.hard_flights import SITUATIONS, random_starts
from support.reference_qp import solve_with_qpoases
from support.rows_alone import without_guesses

from gtmr_model import Helix, Tower, Vehicle
from gtmr_model.dynamics import ATTITUDE
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.compiled import codegen
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_nmpc.reference.qp import CondensedQp

QPS = int(os.environ.get("GTMR_QPS", "20"))
"""How many QPs of each situation; GTMR_QPS=2000 makes the full comparison, in six minutes."""
ACTIVE = 1e-6
"""How close to its limit an input [Hz/s], a speed [Hz] or a clearance [m] counts as at it."""
NO_ANGLE_RAD = 10.0
"""Of larger angles in a plan the difference counts in parts. An iterate that pitches to a right
angle, where Euler angles have no derivative, gives some of thousands of radians."""


def difference(first, second):
    """Largest difference of two solutions in any input, state, slack or margin."""
    apart = {
        name: np.abs(getattr(first, name) - getattr(second, name))
        for name in (
            "u_plan",
            "x_plan",
            "setpoints_hz",
            "slack",
            "alpha_p",
            "alpha_p_by_channel",
            "alpha_g",
        )
    }
    apart["x_plan"][:, ATTITUDE] /= np.maximum(
        1.0, np.abs(second.x_plan[:, ATTITUDE]) / NO_ANGLE_RAD
    )
    return max(each.max() for each in apart.values())


def pair(config, mode):
    """Two controllers of one problem: compiled, and the reference."""
    return (
        Controller(config, mode, CompiledIteration(config)),
        Controller(config, mode, InterpretedIteration(config)),
    )


def active(config, solution):
    """How many inequalities of each kind are active."""
    vehicle, xi = config.vehicle, solution.x_plan[1:, 12:]
    tightened = config.tower.residual(solution.x_plan) + solution.alpha_p + solution.alpha_g
    return Counter(
        inputs=int((np.abs(solution.u_plan) > vehicle.max_rotor_acceleration_hz_s - ACTIVE).sum()),
        speeds=int(
            (
                (xi > vehicle.max_rotor_speed_hz - ACTIVE)
                | (xi < vehicle.min_rotor_speed_hz + ACTIVE)
            ).sum()
        ),
        clearances=int((tightened[1:] > -ACTIVE).sum()),
        slacks=int((solution.slack[1:] > 0.0).sum()),
    )


@pytest.mark.parametrize("name", SITUATIONS)
def test_plans_are_those_of_the_reference_with_qpoases(name, monkeypatch):
    monkeypatch.setattr(CondensedQp, "solve", solve_with_qpoases)
    situation = SITUATIONS[name]
    compiled, reference = pair(situation.config, situation.mode)
    worst, most, qps, seed = 0.0, Counter(), 0, 0
    while qps < QPS:
        compiled.reset()
        reference.reset()
        for t, x, solution in situation.fly(compiled.step, seed):
            worst = max(worst, difference(solution, reference.step(t, x)))
            most |= active(situation.config, solution)
            qps += 1
        seed += 1
    assert worst < 1e-7
    print(f"{name}: {qps} QPs, at most {dict(most)} active, largest difference {worst:.1e}")  # noqa: T201
    assert set(situation.active) <= set(most)


def test_a_clearance_row_gives_way_once_its_multiplier_would_exceed_the_linear_penalty():
    # u^2 / 2 with u + 1 <= s needs a multiplier of 1 to hold with s = 0.
    none, one = np.zeros(0), np.ones(1)
    for l1, slack in ((2.0, 0.0), (0.5, 1 / 6), (0.2, 4 / 15)):
        qp = CondensedQp(
            hessian=np.eye(1),
            gradient=np.zeros(1),
            input_lower=-5.0 * one,
            input_upper=5.0 * one,
            speed_rows=np.zeros((0, 1)),
            speed_lower=none,
            speed_upper=none,
            clearance_rows=np.eye(1),
            clearance_upper=-one,
            slack_l1=l1,
            slack_l2=1.0,
        )
        for solution in (qp.solve(), solve_with_qpoases(qp)):
            np.testing.assert_allclose(solution.slack, slack, atol=1e-6)
            np.testing.assert_allclose(solution.du, slack - 1.0, atol=1e-6)


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("name", ["octo", "quad", "laas"])
def test_other_vehicles(name):
    config = ControllerConfig(vehicle=Vehicle.preset("vehicle", name), tightening="gradient")
    compare_from(config, config.helix.initial_state(config.tower, config.vehicle), steps=8)


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("horizon", [2, 5, 10, 40])
def test_other_horizons(horizon):
    config = ControllerConfig(horizon=horizon, tightening="gradient")
    x = config.helix.initial_state(config.tower, config.vehicle)
    x[0] -= 0.14
    compare_from(config, x, steps=4)


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("iteration", [CompiledIteration, InterpretedIteration])
def test_rounding_decides_no_plan_where_a_margin_is_zero_by_symmetry(iteration):
    config = ControllerConfig(horizon=10, tightening="gradient")
    hover = config.helix.initial_state(config.tower, config.vehicle)
    hover[0] -= 0.14
    plans = []
    for tilt_rad in (0.0, 1e-13, -1e-13):
        x = hover.copy()
        x[3:5] = tilt_rad
        plans.append(Controller(config, "robust", iteration(config)).step(0.0, x))
    assert difference(plans[0], plans[1]) < 1e-7
    assert difference(plans[0], plans[2]) < 1e-7


def compare_from(config, x, steps, mode="robust", closely=1e-7):
    """Feed both controllers the states that the compiled one predicts."""
    compiled, reference = pair(config, mode)
    for k in range(steps):
        t = k * config.sampling_time_s
        solution = compiled.step(t, x)
        expected = reference.step(t, x)
        assert difference(solution, expected) < closely
        assert solution.status == expected.status != "failed"
        x = solution.x_plan[1]


def test_digits_that_the_gram_matrix_loses_come_back():
    limits = {
        "min_rotor_speed_hz": 27.1,
        "max_rotor_speed_hz": 84.9,
        "max_rotor_acceleration_hz_s": 55.0,
    }
    config = ControllerConfig(
        vehicle=Vehicle.paper().model_copy(update=limits),
        tower=Tower(radius_m=2.23),
        helix=Helix(speed_m_s=-0.4, start_angle_rad=1.0),
        slack_l1=57060.0,
        slack_l2=23000.0,
    )
    body = [1.23, 2.08, 1.883, 0.005, 0.18, 4.055, 0.182, 0.127, 0.348, -0.437, -0.029, 0.341]
    x = np.array([*body, 70.133, 40.571, 74.355, 84.891, 80.72, 44.263])
    compare_from(config, x, steps=6, closely=1e-6)
    # Without refinement 4e-5.
    with without_guesses():
        compare_from(config, x, steps=6, closely=5e-6)


def around(middle, spread):
    return st.floats(middle - spread, middle + spread)


@pytest.mark.slow
@settings(max_examples=15, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(
    offset=st.lists(around(0.0, 0.2), min_size=3, max_size=3),
    attitude=st.lists(around(0.0, 0.2), min_size=3, max_size=3),
    velocity=st.lists(around(0.0, 0.5), min_size=6, max_size=6),
    rotors=st.lists(around(61.0, 25.0), min_size=6, max_size=6),
    limits=st.tuples(st.floats(10.0, 60.0), st.floats(63.0, 110.0), st.floats(50.0, 400.0)),
    penalty=st.tuples(st.floats(2.0, 6.0), st.floats(2.0, 6.0)),
    radius_m=st.floats(0.3, 3.0),
    tightening=st.sampled_from(["frozen", "gradient"]),
    mode=st.sampled_from(["nominal", "robust"]),
)
# The iterate ends at a right angle: the plan's last roll is -2545 rad.
@example(
    offset=[4e-05, -0.09003160, 0.04864713],
    attitude=[-0.00741549, 0.0, 0.15697496],
    velocity=[0.0, 0.45733065, 0.051, -0.15887729, 0.44066930, 0.08425949],
    rotors=[75.850796, 86.0, 44.364310, 37.0, 45.620296, 43.230585],
    limits=(40.0, 89.65667, 58.97873773844643),
    penalty=(2.01, 2.26),
    radius_m=1.9,
    tightening="frozen",
    mode="nominal",
)
def test_random_problems(
    offset, attitude, velocity, rotors, limits, penalty, radius_m, tightening, mode
):
    names = ("min_rotor_speed_hz", "max_rotor_speed_hz", "max_rotor_acceleration_hz_s")
    config = ControllerConfig(
        vehicle=Vehicle.paper().model_copy(update=dict(zip(names, limits, strict=True))),
        tower=Tower(radius_m=radius_m),
        helix=Helix(speed_m_s=-0.4, start_angle_rad=1.0),
        tightening=tightening,
        slack_l1=10.0 ** penalty[0],
        slack_l2=10.0 ** penalty[1],
    )
    x = config.helix.initial_state(config.tower, config.vehicle)
    x[:12] += [*offset, *attitude, *velocity]
    x[12:] = rotors
    compare_from(config, x, steps=2, mode=mode)


def test_controllers_in_one_process_do_not_disturb_each_other():
    config = ControllerConfig()
    x = config.helix.initial_state(config.tower, config.vehicle)
    alone = [Controller(config).step(0.0, x)]
    first, second = Controller(config), Controller(config, "nominal")
    kept = first.step(0.0, x)
    second.step(0.0, x + 0.01)
    np.testing.assert_array_equal(kept.x_plan, alone[0].x_plan)
    before = kept.x_plan.copy()
    first.step(0.025, x + 0.01)
    np.testing.assert_array_equal(kept.x_plan, before)


def test_a_state_far_off_never_gives_a_plan_that_is_no_number():
    config = ControllerConfig()
    controller = Controller(config)
    x = config.helix.initial_state(config.tower, config.vehicle)
    x[3:12] = [3.0, 1.5, 2.0, 30.0, -20.0, 10.0, 40.0, -30.0, 50.0]
    for k in range(5):
        assert np.isfinite(controller.step(0.025 * k, x).u).all()


def test_a_plan_that_is_called_solved_keeps_the_rotor_limits_from_anywhere():
    config = ControllerConfig()
    vehicle, starts, solved = config.vehicle, random_starts(config, 80), 0
    # On the third nominal step from the last the active set ends beyond the limits, and is cut.
    for mode, x in [*(("robust", x) for x in starts[:75]), ("nominal", starts[79])]:
        controller = Controller(config, mode, CompiledIteration(config))
        for k in range(4):
            plan = controller.step(0.025 * k, x)
            if plan.status != "failed":
                solved += 1
                assert beyond_limits(vehicle, plan, x[12:]) < 1e-6
            x = plan.x_plan[1]
    assert solved > 250


def beyond_limits(vehicle, plan, xi):
    """How far a plan is beyond rotor limits [Hz/s, Hz], less what it takes to return."""
    reach = vehicle.max_rotor_acceleration_hz_s * 0.025 * np.arange(1, 21)[:, None]
    lowest = np.minimum(vehicle.min_rotor_speed_hz, xi + reach)
    highest = np.maximum(vehicle.max_rotor_speed_hz, xi - reach)
    return max(
        np.abs(plan.u_plan).max() - vehicle.max_rotor_acceleration_hz_s,
        (lowest - plan.x_plan[1:, 12:]).max(),
        (plan.x_plan[1:, 12:] - highest).max(),
    )


@pytest.mark.parametrize(("row", "column"), [(9, 6), (11, 3), (12, 10), (14, 18)])
def test_a_model_that_the_recursion_would_get_wrong_is_refused(row, column):
    dense = ca.Sparsity.dense(15, 24)
    allowed = np.ones((15, 24), bool)
    allowed[9:12, :9] = allowed[12:, 9:12] = allowed[12:, 18:] = False
    rows, columns = np.nonzero(allowed)
    known = ca.Sparsity.triplet(*dense.shape, rows.tolist(), columns.tolist())
    codegen.require_structure(known)
    one_more = known + ca.Sparsity.triplet(*dense.shape, [row], [column])
    with pytest.raises(ValueError, match=rf"\({row}, {column}\)"):
        codegen.require_structure(one_more)
