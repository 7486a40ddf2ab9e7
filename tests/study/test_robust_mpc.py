# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import casadi as ca
import numpy as np
import pytest

from gtmr_model import N_ZETA, Helix, dynamics
from gtmr_model.dynamics import POSITION, VELOCITY, YAW
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.margins import Iterate
from gtmr_nmpc.ocp import discrete_dynamics, disturbed_dynamics
from gtmr_sim import GustConfig, Scenario, fly
from gtmr_study.rivals.robust_mpc.ancillary import Ancillary, about_hover
from gtmr_study.rivals.robust_mpc.cost import CostParameters
from gtmr_study.rivals.robust_mpc.ellipsoid import (
    ELLIPSOID,
    ELLIPSOID_FEEDBACK,
    EllipsoidMargin,
    shares,
)
from gtmr_study.rivals.robust_mpc.linearised import jacobians, linearise
from gtmr_study.rivals.robust_mpc.min_max import MinMax, vertices
from gtmr_study.rivals.robust_mpc.scenario_tree import (
    SCENARIO_TREE,
    ScenarioTree,
    TreeParameters,
    winds,
)
from gtmr_study.rivals.robust_mpc.tube import (
    TUBE,
    Tube,
    cross_section,
    error_responses,
    tightened,
)
from gtmr_study.solvers.nlp import references, stage_cost, terminal_cost

CONFIG = CostParameters().weigh(ControllerConfig())
STEP = discrete_dynamics(CONFIG)
"""Of the model, (x, u, zeta) -> x."""
SMALL = 1e-3
"""Share of the bounds at which deviations are linear."""


@pytest.fixture(scope="module")
def plan():
    """A plan that tilts, whose states are those of its inputs."""
    x = CONFIG.helix.initial_state(CONFIG.tower, CONFIG.vehicle)
    x[:12] += [-0.05, 0.02, 0.0, 0.05, -0.1, 0.1, -0.2, 0.1, 0.1, 0.2, 0.1, -0.1]
    u = Controller(CONFIG, "nominal").step(0.0, x).u_plan
    states, step = [x], disturbed_dynamics(CONFIG)
    for inputs in u:
        states.append(np.asarray(step(states[-1], inputs, 0, 0, 0)).ravel())
    return Iterate(CONFIG, np.array(states), u, lambda: None)


def flown_deviations(plan, zeta, gusts, ancillary):
    """Positions off the plan under mismatch and gusts, by the nonlinear model [m], (N + 1, 3)."""
    step, x = disturbed_dynamics(CONFIG), plan.x[0]
    off = [np.zeros(3)]
    for at, u, gust in zip(plan.x, plan.u, gusts, strict=False):
        if ancillary is not None:
            u = u + ancillary.gain(at[YAW]) @ (x - at)
        x = np.asarray(step(x, u, zeta, gust, 0)).ravel()
        off.append(x[POSITION] - plan.x[len(off), POSITION])
    return np.array(off)


def extreme_disturbances(rng):
    """A vertex of zeta's box and gusts at their bound, each along the worst lines or random."""
    zeta = rng.choice([-1.0, 1.0], N_ZETA) * CONFIG.uncertainty.half_widths
    directions = rng.normal(size=(CONFIG.horizon, 3))
    if rng.random() < 0.5:
        directions[:] = directions[0]
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return zeta, CONFIG.uncertainty.gust_n * unit


@pytest.mark.parametrize("feedback", [False, True])
def test_the_ellipsoids_hold_what_vertices_and_gusts_do_to_the_plan(plan, feedback):
    margin = EllipsoidMargin(CONFIG, feedback)
    moved = margin.generators(plan)
    reach = moved[:, POSITION] / np.sqrt(shares(moved[-1]))
    shapes = reach @ reach.transpose(0, 2, 1)
    normals = CONFIG.clearance_constraint.gradient(plan.x)
    half_widths, rng = margin.tightening(plan) - CONFIG.eps_s_m, np.random.default_rng(1)
    closest = 0.0
    for _ in range(60):
        zeta, gusts = extreme_disturbances(rng)
        off = flown_deviations(plan, SMALL * zeta, SMALL * gusts, margin._ancillary) / SMALL
        for shape, e in zip(shapes[2:], off[2:], strict=True):
            assert e @ np.linalg.solve(shape, e) <= 1.0 + 1e-2
        across = (normals * off).sum(axis=1)
        assert (np.abs(across) <= half_widths * 1.01 + 1e-9).all()
        closest = max(closest, np.abs(across[-1]) / half_widths[-1])
    # No more than needed either: some of them come close.
    assert closest > 0.5


def test_compiled_jacobians_are_those_of_casadi(plan):
    of = jacobians(CONFIG.vehicle, CONFIG.sampling_time_s)
    given = CONFIG.vehicle, CONFIG.sampling_time_s, plan.x[:-1], plan.u
    for i, blocks in enumerate(zip(*linearise(*given), strict=True)):
        for ours, theirs in zip(blocks, of(plan.x[i], plan.u[i]), strict=True):
            assert np.allclose(ours, np.asarray(theirs), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("feedback", [False, True])
def test_generators_give_the_shape_matrices_of_zoro(plan, feedback):
    config, margin = CONFIG, EllipsoidMargin(CONFIG, feedback)
    moved = margin.generators(plan)
    share, n_x = shares(moved[-1]), config.vehicle.n_x
    box, gust_n = config.uncertainty.half_widths, config.uncertainty.gust_n
    assert share[:N_ZETA].sum() + share[N_ZETA::3].sum() == pytest.approx(1.0)
    # The state augmented with zeta, which stays what it is.
    p = np.zeros((n_x + N_ZETA, n_x + N_ZETA))
    p[n_x:, n_x:] = np.diag(box**2 / share[:N_ZETA])
    of = jacobians(config.vehicle, config.sampling_time_s)
    for i, (x, u) in enumerate(zip(plan.x, plan.u, strict=False)):
        a, b, e, g = (np.asarray(block) for block in of(x, u))
        step = np.eye(n_x + N_ZETA)
        step[:n_x, :n_x] = a + b @ Ancillary(config).gain(x[YAW]) if feedback else a
        step[:n_x, n_x:] = e
        p = step @ p @ step.T
        p[:n_x, :n_x] += gust_n**2 / share[N_ZETA + 3 * i] * (g @ g.T)
        reach = moved[i + 1] / np.sqrt(share)
        assert reach @ reach.T == pytest.approx(p[:n_x, :n_x], abs=1e-9, rel=1e-9)


def test_feedback_makes_the_ellipsoids_smaller_and_a_delay_makes_them_larger(plan):
    open_loop, fed_back = (EllipsoidMargin(CONFIG, by).tightening(plan) for by in (False, True))
    assert fed_back[-1] < 0.7 * open_loop[-1]
    late = EllipsoidMargin(CONFIG.model_copy(update={"delay_s": 0.05}), True).tightening(plan)
    assert (late > fed_back).all()


def test_the_ancillary_gain_turns_with_the_vehicle():
    of, config = jacobians(CONFIG.vehicle, CONFIG.sampling_time_s), CONFIG
    for yaw in (0.3, -2.0):
        x = config.helix.initial_state(config.tower, config.vehicle) * 0.0
        x[YAW], x[12:] = yaw, config.vehicle.hover_rotor_speeds_hz
        a, b, _, _ = (np.asarray(block) for block in of(x, np.zeros(config.vehicle.n_rotors)))
        modes = np.linalg.eigvals(a + b @ Ancillary(config).gain(yaw))
        assert np.abs(modes).max() < 0.99


def test_the_cost_is_the_papers_by_factors():
    old = ControllerConfig().weights
    scales = CostParameters(position_scale=3.0, velocity_scale=0.5, acceleration_scale=0.2)
    new = scales.weigh(ControllerConfig()).weights
    for name, factor in (
        ("position", 3.0),
        ("terminal_position", 3.0),
        ("velocity", 0.5),
        ("acceleration", 0.2),
    ):
        assert getattr(new, name) == pytest.approx(factor * np.array(getattr(old, name)))
    assert new.rotor_acceleration == scales.rotor_acceleration
    assert new.roll_pitch == old.roll_pitch


def calm_flight(rival, d_ref_m=0.30):
    """Settled radial RMS [m] in the paper's world without mismatch and gusts."""
    helix = Helix(offset_m=d_ref_m)
    scenario = Scenario(helix=helix, gust=GustConfig(kind="none"), guard="hold")
    log = fly(scenario, rival(ControllerConfig(helix=helix), scenario), 6.5)
    return float(np.sqrt(np.mean((log.d_T[log.t >= 5.0] - d_ref_m) ** 2)))


@pytest.mark.parametrize(
    "rival",
    [ELLIPSOID, ELLIPSOID_FEEDBACK, TUBE, pytest.param(SCENARIO_TREE, marks=pytest.mark.slow)],
    ids=lambda rival: rival.name,
)
def test_each_flies_calmly_where_nothing_disturbs(rival):
    assert calm_flight(rival) < 0.02


class Recorded:
    """A tube and where its plan and the vehicle were at every step."""

    def __init__(self, tube):
        self.tube, self.config, self.off_m = tube, tube.config, []

    def step(self, t, x):
        command = self.tube.step(t, x)
        rho = [np.hypot(*at[:2]) for at in (x, self.tube.z)]
        self.off_m.append(rho[0] - rho[1])
        return command


def test_no_flight_leaves_the_tube_and_the_worst_ones_use_it():
    half_width_m = Tube(ControllerConfig(), CostParameters()).cross_section.clearance_m
    used = []
    for k, zeta in enumerate(ControllerConfig().uncertainty.vertices()[[3, 7, 255, 259, 455]]):
        gust = GustConfig(kind="worst-case")
        scenario = Scenario(zeta=tuple(zeta), gust=gust, guard="hold", seed=k)
        flown = Recorded(Tube(ControllerConfig(), CostParameters()))
        fly(scenario, flown, 3.0)
        used.append(np.abs(flown.off_m).max() / half_width_m)
    # The corners of mass and thrust are nonlinear by what the linear model leaves out.
    assert 0.5 < max(used) < 1.05


def test_the_cross_section_is_what_the_worst_gusts_do_to_the_linear_error():
    config = CostParameters().weigh(ControllerConfig())
    errors, _ = error_responses(config)
    gusts = errors[:, 0, N_ZETA : N_ZETA + 3]
    a, b, e, g = about_hover(config)
    closed = a + b @ Ancillary(config).gain(np.pi)
    # What reaches furthest after K steps is along each response, last things first.
    worst = gusts[::-1] / np.maximum(np.linalg.norm(gusts[::-1], axis=1, keepdims=True), 1e-30)
    error = np.zeros(config.vehicle.n_x)
    for gust in config.uncertainty.gust_n * worst[:-1]:
        error = closed @ error + g @ gust
    wind = np.linalg.solve(np.eye(len(closed)) - closed, e[:, 6]) * np.hypot(0.8, 0.8)
    noise_m = 3.0 * np.sqrt((errors[:, 0, N_ZETA + 3 :] ** 2).sum(axis=0))
    odometry = config.offset_free.noise
    noise_m = noise_m @ np.diag(
        np.repeat(
            [
                odometry.position_m,
                odometry.attitude_rad,
                odometry.velocity_m_s,
                odometry.rate_rad_s,
            ],
            3,
        )
    )
    reached_m = abs(error[0]) + abs(wind[0])
    half_width_m = cross_section(config).clearance_m - float(np.linalg.norm(noise_m))
    assert reached_m <= half_width_m + 1e-6
    assert reached_m > 0.98 * half_width_m


def test_a_plan_keeps_what_the_feedback_does_not_need():
    config = CostParameters().weigh(ControllerConfig())
    section = cross_section(config)
    plan, full = tightened(config, section).vehicle, config.vehicle
    needed = full.max_rotor_acceleration_hz_s - plan.max_rotor_acceleration_hz_s
    assert needed == pytest.approx(min(section.acceleration_hz_s, 140.0))
    assert plan.max_rotor_speed_hz < full.max_rotor_speed_hz
    assert plan.min_rotor_speed_hz > full.min_rotor_speed_hz


def one_scenario(config, position):
    return np.zeros((1, 3))


@pytest.mark.parametrize("off_m", [(0.0, 0.0, 0.0), (-0.3, 0.1, 0.1)])
def test_a_tree_of_one_scenario_is_the_nominal_controller(off_m):
    tree = ScenarioTree(ControllerConfig(), TreeParameters(), one_scenario)
    nominal, differences, slacks = Controller(CONFIG, "nominal"), [], []

    class Both:
        def step(self, t, x):
            solution = nominal.step(t, x)
            slacks.append(solution.slack.max())
            differences.append(np.abs(tree.plan(t, x) - solution.u).max())
            return solution

    fly(Scenario(start_offset_m=off_m, guard="hold", seed=3).sampled(), Both(), 0.25)
    assert max(differences) < 1e-6
    # One of the flights starts too close, where rows are soft.
    assert (max(slacks) > 0.1) == (off_m[0] < 0.0)


def test_the_scenarios_are_no_wind_and_the_worst_ones_in_and_out():
    box = ControllerConfig().uncertainty
    for at in ([1.3, 0.2, 2.0], [-0.4, 1.2, 3.0]):
        none, inwards, out = winds(ControllerConfig(), np.array(at))
        outward = np.array([at[0], at[1], 0.0]) / np.hypot(at[0], at[1])
        corners = box.vertices()[:, 6:9] @ outward
        assert not none.any()
        assert inwards @ outward == pytest.approx(corners.min() - box.gust_n)
        assert np.allclose(out, -inwards)


@pytest.mark.parametrize("common", [1, 20])
def test_every_branch_of_a_tree_keeps_the_clearance(common):
    tree = ScenarioTree(ControllerConfig(), TreeParameters(common_stages=float(common)))
    x = CONFIG.helix.initial_state(CONFIG.tower, CONFIG.vehicle)
    x[0] -= 0.12
    for k in range(3):
        tree.plan(0.025 * k, x)
    rho = np.array([np.hypot(b.x[:, 0], b.x[:, 1]) for b in tree._branches])
    u = np.array([b.u for b in tree._branches])
    assert (rho[:, 1:] - CONFIG.tower.radius_m > CONFIG.tower.min_clearance_m - 1e-3).all()
    assert np.ptp(u[:, :common], axis=0) == pytest.approx(0.0, abs=1e-6)
    assert common == 20 or np.ptp(u[:, common], axis=0).max() > 1.0
    assert (np.abs(u) <= CONFIG.vehicle.max_rotor_acceleration_hz_s + 1e-6).all()
    # The tree keeps more than the nominal plan does from where the wind may push.
    alone = Controller(CONFIG, "nominal").step(0.0, x).x_plan
    assert rho[0].min() >= np.hypot(alone[:, 0], alone[:, 1]).min() - 1e-6


def test_min_max_has_the_least_worst_cost():
    config = CONFIG.model_copy(update={"horizon": 5})
    zetas, x = vertices(config, (6,)), config.helix.initial_state(config.tower, config.vehicle)
    x[0] += 0.05
    u, solution = MinMax(config, zetas).solve(0.0, x)
    nominal = Controller(config, "nominal")
    alone = nominal.step(0.0, x).u_plan

    def worst(plan):
        return max(rolled_cost(config, x, plan, zeta) for zeta in zetas)

    assert worst(u) == pytest.approx(solution[u.size], rel=1e-4)
    assert worst(u) < worst(alone)
    rng = np.random.default_rng(2)
    assert all(worst(u) < worst(u + rng.normal(0.0, 2.0, u.shape)) for _ in range(20))


def rolled_cost(config, x, plan, zeta):
    """Cost of a plan under one zeta, by rolling the vehicle out; the clearance is far."""
    r, total = references(config, 0.0), 0.0
    for u, at in zip(plan, r, strict=False):
        a = dynamics(x, u, zeta, np.zeros(3), config.vehicle)[VELOCITY]
        total += float(stage_cost(config, ca.DM(x), ca.DM(u), ca.DM(a), ca.DM(at)))
        x = np.asarray(STEP(x, u, zeta)).ravel()
    return total + float(terminal_cost(config, ca.DM(x), ca.DM(r[-1])))
