# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.
import numpy as np
import pytest

from gtmr_model import N_ZETA, Helix
from gtmr_model.dynamics import POSITION, YAW
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.margins import Iterate
from gtmr_nmpc.ocp import disturbed_dynamics
from gtmr_sim import GustConfig, Scenario, fly
from gtmr_study.rivals.robust_mpc.ancillary import Ancillary, jacobians
from gtmr_study.rivals.robust_mpc.cost import CostParameters
from gtmr_study.rivals.robust_mpc.ellipsoid import (
    ELLIPSOID,
    ELLIPSOID_FEEDBACK,
    EllipsoidMargin,
    shares,
)

CONFIG = CostParameters().weigh(ControllerConfig())
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


def calm_flight(rival, d_ref_m=0.30):
    """Settled radial RMS [m] in the paper's world without mismatch and gusts."""
    helix = Helix(offset_m=d_ref_m)
    scenario = Scenario(helix=helix, gust=GustConfig(kind="none"), guard="hold")
    log = fly(scenario, rival(ControllerConfig(helix=helix), scenario), 8.0)
    return float(np.sqrt(np.mean((log.d_T[log.t >= 5.0] - d_ref_m) ** 2)))


@pytest.mark.parametrize("rival", [ELLIPSOID, ELLIPSOID_FEEDBACK])
def test_each_flies_calmly_where_nothing_disturbs(rival):
    assert calm_flight(rival) < 0.02
