# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The controller as its users see it: warm start, mode switching, limits, refusals."""

import numpy as np
import pytest

from gtmr_model import Vehicle
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_nmpc.reference.rti import RealTimeIteration
from gtmr_sim import Scenario, Simulation, fly

SCENARIO = Scenario(zeta=(0.0,) * 6 + (0.6, 0.4, 0.0))
START = SCENARIO.helix.initial_state(SCENARIO.tower, SCENARIO.vehicle)


def test_prepared_and_unprepared_steps_are_the_same():
    at_once, in_phases = Controller(), Controller()
    simulation = Simulation(SCENARIO, 0.025)
    for k in range(20):
        in_phases.prepare(0.025 * k)
        first = at_once.step(0.025 * k, simulation.x)
        second = in_phases.feedback(0.025 * k, simulation.x)
        np.testing.assert_array_equal(first.x_plan, second.x_plan)
        simulation.command(0.025 * k, first.u_plan)
        simulation.advance(0.025)


def test_yaw_may_come_wrapped():
    wrapped = START.copy()
    wrapped[5] -= 4 * np.pi
    plain, turned = Controller().step(0.0, START), Controller().step(0.0, wrapped)
    np.testing.assert_allclose(plain.u_plan, turned.u_plan, atol=1e-9)


def test_reset_forgets_the_warm_start():
    controller = Controller()
    first = controller.step(0.0, START)
    for k in range(1, 10):
        controller.step(0.025 * k, START)
    controller.reset()
    np.testing.assert_array_equal(controller.step(0.0, START).u_plan, first.u_plan)


@pytest.mark.parametrize("gap_s", [0.025, 0.1, 3.0, -1.0])
def test_steps_that_were_missed_or_time_that_jumps_do_no_harm(gap_s):
    controller = Controller()
    controller.step(0.0, START)
    step = controller.step(1.0, START)
    x = SCENARIO.helix.initial_state(SCENARIO.tower, SCENARIO.vehicle)
    later = controller.step(1.0 + gap_s, x)
    assert step.status == later.status == "solved"
    assert np.isfinite(later.u_plan).all()


def test_switching_mode_far_from_the_constraint_changes_nothing():
    # Away from the constraint both problems have one solution; only the warm start could differ.
    switched, steady = Controller(mode="nominal"), Controller(mode="robust")
    for k in range(5):
        switched.step(0.025 * k, START)
        steady.step(0.025 * k, START)
    switched.mode = "robust"
    first, second = (c.step(0.125, START) for c in (switched, steady))
    np.testing.assert_allclose(first.u_plan, second.u_plan, atol=1e-9)
    assert 0.0 < first.alpha_p[-1] < second.alpha_p[-1]


@pytest.mark.parametrize(("mode", "other"), [("nominal", "robust"), ("robust", "nominal")])
def test_the_margins_come_and_go_within_the_switch_time(mode, other):
    controller = Controller(ControllerConfig(switch_time_s=0.5), mode)
    controller.step(0.0, START)
    controller.mode = other
    scales = [controller.step(0.025 * k, START).margin_scale for k in range(1, 25)]
    coming = scales if other == "robust" else [1.0 - scale for scale in scales]
    assert 0.0 < coming[0] < 0.01
    assert np.all(np.diff(coming[:20]) > 0.0)
    assert coming[19:] == pytest.approx([1.0] * 5)


def test_a_reset_and_a_switch_on_the_ground_are_at_once():
    controller = Controller(mode="nominal")
    controller.step(0.0, START)
    controller.reset()
    controller.mode = "robust"
    assert controller.step(0.0, START).margin_scale == 1.0


def test_a_switch_makes_no_bump_where_the_vehicle_is_inside_the_tightened_shell():
    # The wind presses the vehicle against the plain constraint, some centimetres inside.
    def jump(switch_time_s):
        controller = Controller(ControllerConfig(switch_time_s=switch_time_s), "nominal")
        simulation, u, steps = Simulation(SCENARIO, 0.025), None, []
        for k in range(301):
            if k == 300:
                controller.mode = "robust"
            before, u = u, controller.step(0.025 * k, simulation.x).u
            steps.append(0.0 if before is None else np.abs(u - before).max())
            simulation.command(0.025 * k, [u])
            simulation.advance(0.025)
        return steps[300]

    assert jump(0.0) > 20.0
    assert jump(1.0) < 1.0


def test_other_numbers_keep_the_warm_start_and_are_those_of_a_new_controller():
    config = ControllerConfig(
        tower={"min_clearance_m": 0.25},
        uncertainty={"mass": 0.05, "gust_n": 0.3},
        weights={"position": (10.0, 20.0, 30.0), "rotor_acceleration": 1e-3},
        eps_s_m=0.01,
    )
    changed, new = Controller(), Controller(config)
    for k in range(3):
        changed.step(0.025 * k, START)
    changed.prepare(0.075)
    changed.reconfigure(config)
    for k in range(3, 40):
        last = changed.step(0.025 * k, START)
        fresh = new.step(0.025 * k, START)
    np.testing.assert_allclose(last.alpha_p, fresh.alpha_p, rtol=1e-3)
    np.testing.assert_allclose(last.alpha_g, fresh.alpha_g)
    np.testing.assert_allclose(last.u_plan, fresh.u_plan, atol=0.1)


@pytest.mark.parametrize("fixed", [{"horizon": 10}, {"sampling_time_s": 0.05}])
def test_what_the_controller_is_built_for_cannot_change(fixed):
    controller = Controller()
    with pytest.raises(ValueError, match=next(iter(fixed))):
        controller.reconfigure(ControllerConfig(**fixed))
    assert controller.config == ControllerConfig()


def test_switch_between_prepare_and_feedback_takes_effect_at_once():
    controller = Controller(mode="nominal")
    controller.step(0.0, START)
    controller.prepare(0.025)
    controller.mode = "robust"
    assert controller.feedback(0.025, START).alpha_g[-1] > 0.0


def test_plan_respects_rotor_limits_from_any_start():
    vehicle = Vehicle.paper()
    rng = np.random.default_rng(1)
    for _ in range(20):
        x = START.copy()
        x[:3] += rng.uniform(-0.3, 0.5, 3)
        x[6:9] += rng.uniform(-1.0, 1.0, 3)
        x[12:] = rng.uniform(0.0, 110.0, 6)
        step = Controller(mode="nominal").step(0.0, x)
        assert step.status != "failed"
        assert np.abs(step.u_plan).max() <= vehicle.max_rotor_acceleration_hz_s + 1e-6
        # A rotor outside its limits returns as fast as it can, and then stays within.
        reach = vehicle.max_rotor_acceleration_hz_s * 0.025 * np.arange(21)[:, None]
        lowest = np.minimum(vehicle.min_rotor_speed_hz, x[12:] + reach)
        highest = np.maximum(vehicle.max_rotor_speed_hz, x[12:] - reach)
        assert (step.x_plan[:, 12:] >= lowest - 1e-6).all()
        assert (step.x_plan[:, 12:] <= highest + 1e-6).all()


def test_start_inside_the_forbidden_zone_reports_its_slack_and_leaves_the_zone():
    x = START.copy()
    x[0] = SCENARIO.tower.radius_m + 0.1
    x[6:9] = 0.0
    controller = Controller(mode="robust")
    first = controller.step(0.0, x)
    assert first.status == "softened"
    assert first.slack[0] == pytest.approx(0.1 + first.eps_s[0])
    simulation = Simulation(Scenario(), 0.025)
    simulation.plant.x = x
    for k in range(80):
        simulation.command(0.025 * k, controller.step(0.025 * k, simulation.x).u_plan)
        simulation.advance(0.025)
    assert SCENARIO.tower.clearance(simulation.x) > SCENARIO.tower.min_clearance_m


def test_predicted_states_follow_the_discrete_dynamics_along_a_flight():
    controller, rti = Controller(), RealTimeIteration(ControllerConfig())
    defects = []

    class Watched:
        def step(self, t, x):
            solution = controller.step(t, x)
            rollout = rti.predict(solution.x_plan[0], solution.u_plan[0])
            defects.append(np.abs(rollout - solution.x_plan[1]).max())
            return solution

    fly(SCENARIO, Watched(), 2.0)
    assert max(defects) < 1e-3


@pytest.mark.parametrize("name", ["octo", "quad", "laas"])
@pytest.mark.parametrize("mode", ["nominal", "robust"])
def test_other_vehicles_fly_the_helix(name, mode):
    vehicle = Vehicle.preset("vehicle", name)
    scenario = Scenario(vehicle=vehicle)
    log = fly(scenario, Controller(ControllerConfig(vehicle=vehicle), mode), 4.0)
    reference = scenario.helix.at(log.t, scenario.tower)
    assert np.abs(log.x[:, :3] - reference.position).max() < 0.25
    assert not log.failed.any()


@pytest.mark.parametrize("mode", ["Robust", "", None, 1])
def test_unknown_mode_is_refused_and_the_old_one_stays(mode):
    controller = Controller(mode="nominal")
    with pytest.raises(ValueError, match=r"mode = .*: allowed is nominal or robust"):
        controller.mode = mode
    assert controller.mode == "nominal"


def test_states_that_are_none_are_refused():
    with pytest.raises(ValueError, match="x has shape"):
        Controller().step(0.0, np.zeros(17))
    with pytest.raises(ValueError, match="not finite"):
        Controller().step(0.0, START * np.nan)


def plan_to_slack(slack_m):
    return {"slack": np.full(21, slack_m)}


def plan_to_pitch(pitch_rad):
    x_plan = np.tile(START, (21, 1))
    x_plan[-1, 4] = pitch_rad
    return {"x_plan": x_plan}


AXIS_M = SCENARIO.tower.radius_m + SCENARIO.tower.min_clearance_m


@pytest.mark.parametrize("fit", [plan_to_slack(0.99 * AXIS_M), plan_to_pitch(1.5)])
def test_a_hard_but_sound_plan_is_the_next_start(fit):
    assert starts(fit) == "cwwww"


@pytest.mark.parametrize(
    "unfit",
    [{"status": "failed"}, plan_to_slack(1.01 * AXIS_M), plan_to_pitch(1.6), plan_to_pitch(-1.6)],
)
def test_after_an_unfit_plan_the_next_step_starts_from_the_measured_state(unfit):
    assert starts(unfit) == "cwwcw"


def starts(third):
    """Cold and warm starts of five steps of which the third gives a plan with other entries."""

    class FailsOnce(InterpretedIteration):
        starts = ""

        def cold(self, x):
            self.starts += "c"
            super().cold(x)

        def warm(self, steps):
            self.starts += "w"
            super().warm(steps)

        def feedback(self, x):
            plan = super().feedback(x)
            return plan._replace(**third) if len(self.starts) == 3 else plan

    iteration = FailsOnce(ControllerConfig())
    controller = Controller(iteration=iteration)
    for k in range(5):
        controller.step(0.025 * k, START)
    return iteration.starts


FAST_APPROACH = START.copy()
FAST_APPROACH[:9] += [-0.0012, 0.0263, 0.1943, -0.0288, 0.1372, 0.0, -0.5024, -0.0497, 0.48]
FAST_APPROACH[12:] = [37.1641, 60.7094, 45.6946, 85.1406, 81.4439, 84.5922]


def test_a_plan_that_turns_over_does_not_turn_the_next_command_around():
    # Alone: the guard would take charge of so fast an approach.
    simulation, controller = Simulation(Scenario(guard="hold"), 0.025), Controller()
    simulation.plant.x = FAST_APPROACH
    turned_over = False
    while not turned_over:
        assert simulation.time_s < 0.2
        solution = controller.step(simulation.time_s, simulation.x)
        turned_over = np.abs(solution.x_plan[:, 4]).max() > np.pi / 2
        simulation.command(simulation.time_s, solution.u_plan)
        simulation.advance(0.025)
    command = controller.step(simulation.time_s, simulation.x).u
    # What IPOPT plans too; from the plan that turned over the signs would be the opposite.
    np.testing.assert_allclose(command, [200.0, 200.0, 200.0, -200.0, -200.0, 0.0], atol=0.5)


def test_a_fast_approach_with_unequal_rotors_is_stopped_before_the_tower():
    alone = SCENARIO.model_copy(update={"guard": "hold"})
    simulation, controller = Simulation(alone, 0.025), Controller()
    simulation.plant.x = FAST_APPROACH
    for _ in range(80):
        solution = controller.step(simulation.time_s, simulation.x)
        assert solution.status != "failed"
        simulation.command(simulation.time_s, solution.u_plan)
        simulation.advance(0.025)
        assert SCENARIO.tower.clearance(simulation.x[:3]) > 0.05
