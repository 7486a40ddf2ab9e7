# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The airframe's clearance: never above the distance of any point of its discs, and smooth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gtmr_model import ConfigError, Tower, Vehicle, airframe_clearance
from gtmr_model.airframe import BLEND_M, CENTRE, airframe_constraint, constraint_on

PAPER, TOWER = Vehicle.paper(), Tower()


def sampled_clearance(pose, vehicle, tower, points=720):
    """Least distance of points on the rims of the discs to the tower's surface [m]."""
    turn = Rotation.from_euler("ZYX", pose[[5, 4, 3]])
    angle = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    least = np.inf
    for rotor in vehicle.rotors:
        across = np.linalg.svd(rotor.axis[None])[2][1:]
        rim = np.cos(angle)[:, None] * across[0] + np.sin(angle)[:, None] * across[1]
        at = pose[:3] + turn.apply(np.array(rotor.position_m) + vehicle.rotor_radius_m * rim)
        least = min(least, np.hypot(at[:, 0], at[:, 1]).min() - tower.radius_m)
    return least


def poses(most_tilt_rad):
    """Around the tower, hubs outside of it, any yaw."""
    tilt = st.floats(-most_tilt_rad, most_tilt_rad)
    turn = st.floats(-np.pi, np.pi)
    made = st.tuples(st.floats(1.5, 4.0), turn, st.floats(0.0, 9.0), tilt, tilt, turn)
    return made.map(lambda v: np.array([v[0] * np.cos(v[1]), v[0] * np.sin(v[1]), *v[2:]]))


@settings(deadline=None)
@given(st.sampled_from([(0.0, 1e-4), (0.2, 5e-4)]), st.data())
def test_clearance_is_that_of_the_nearest_point_of_the_discs_to_a_fraction_of_a_millimetre(
    tilted, data
):
    (most_tilt_rad, short_m), name = tilted, data.draw(st.sampled_from(["paper", "octo", "quad"]))
    pose = data.draw(poses(most_tilt_rad))
    vehicle = Vehicle.preset("vehicle", name)
    truth = sampled_clearance(pose, vehicle, TOWER)
    assert truth - short_m <= airframe_clearance(pose, vehicle, TOWER) <= truth + 2e-6


@settings(deadline=None)
@given(poses(1.4))
def test_clearance_is_never_above_the_truth_at_any_tilt(pose):
    truth = sampled_clearance(pose, PAPER, TOWER)
    # A rim of 720 points is up to r (1 - cos(pi / 720)) = 1.5e-6 m short of the circle.
    assert truth - 2e-2 <= airframe_clearance(pose, PAPER, TOWER) <= truth + 2e-6


def test_clearance_facing_the_tower_is_that_of_the_tip_of_the_front_disc():
    pose = np.array([-3.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    tip = 0.39 + PAPER.rotor_radius_m
    assert airframe_clearance(pose, PAPER, TOWER) == pytest.approx(2.0 - tip, abs=1e-9)


def test_with_the_papers_reference_a_hub_is_inside_the_tower():
    hubs = PAPER.model_copy(update={"rotor_radius_m": 0.0})
    pose = np.array([-1.35, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert airframe_clearance(pose, hubs, TOWER) == pytest.approx(-0.04, abs=1e-9)


def test_clearance_keeps_the_shape_of_its_states():
    states = np.tile(np.r_[2.0, np.zeros(17)], (4, 3, 1))
    assert airframe_clearance(states, PAPER, TOWER).shape == (4, 3)
    assert airframe_clearance(states[0, 0], PAPER, TOWER).shape == ()


@settings(deadline=None)
@given(poses(0.6))
def test_constraint_is_below_the_clearance_by_at_most_its_blend(pose):
    y = airframe_constraint(PAPER).residual(pose[None], TOWER)[0]
    nearest = TOWER.min_clearance_m - airframe_clearance(pose, PAPER, TOWER)
    assert nearest - 1e-12 <= y <= nearest + BLEND_M * np.log(PAPER.n_rotors) + 1e-12


@settings(deadline=None)
@given(poses(0.6))
def test_constraints_derivatives_are_those_of_finite_differences(pose):
    constraint, step = airframe_constraint(PAPER), 1e-6
    direction = np.array([[0.3, -0.2, 0.5, 0.1, -0.4, 0.2]])
    around = pose + np.vstack([np.zeros(6), step * np.eye(6), -step * np.eye(6)])
    y = constraint.residual(around, TOWER)
    slopes = constraint.gradient(around)
    gradient = (y[1:7] - y[7:]) / (2.0 * step)
    np.testing.assert_allclose(slopes[0], gradient, atol=2e-6)
    along = slopes @ direction[0]
    bent = (along[1:7] - along[7:]) / (2.0 * step)
    curvature = constraint.curvature(pose[None], direction)[0]
    # At ties the constraint bends over the blend: its third derivatives are of 1 / BLEND_M^2.
    np.testing.assert_allclose(curvature, bent, atol=1e-4, rtol=1e-5)


@given(poses(0.6))
def test_the_centres_value_is_that_of_the_function_its_gradient_comes_from(pose):
    y, gradient, _ = CENTRE.function(pose[:3], TOWER.numbers, np.zeros(3))
    assert CENTRE.residual(pose[None], TOWER)[0] == pytest.approx(float(y), abs=1e-12)
    np.testing.assert_array_equal(CENTRE.gradient(pose[None]), np.asarray(gradient))


def test_constraint_does_not_depend_on_the_height():
    assert airframe_constraint(PAPER).states == (0, 1, 3, 4, 5)
    assert CENTRE.states == (0, 1)
    assert constraint_on("centre", PAPER) is CENTRE


def test_a_negative_radius_is_refused():
    with pytest.raises(ConfigError, match=r"rotor_radius_m = -0.1: .*greater than or equal to 0"):
        Vehicle.parse(PAPER.model_dump() | {"rotor_radius_m": -0.1}, "vehicle")
