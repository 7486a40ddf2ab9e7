# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Near-wall suction and thrust loss, against closed forms."""

import math

import casadi as ca
import numpy as np
import pytest

from gtmr_model import Tower, Vehicle
from gtmr_model.vehicle import GRAVITY_M_S2
from gtmr_sim.worlds.wall import Wall, wall_effect

VEHICLE, TOWER = Vehicle.paper(), Tower()
HOVER = VEHICLE.hover_rotor_speeds_hz


def wrench(wall, clearance_m, angle_rad=0.0, zeta=0.0, vehicle=VEHICLE, level=(0.0, 0.0)):
    """Force and torque on a vehicle that faces the tower."""
    x, mismatch = ca.SX.sym("x", vehicle.n_x), ca.SX.sym("zeta", 9)
    effect = ca.Function("effect", [x, mismatch], wall_effect(wall, x, mismatch, vehicle, TOWER))
    rho = TOWER.radius_m + clearance_m
    state = np.zeros(vehicle.n_x)
    state[:3] = rho * math.cos(angle_rad), rho * math.sin(angle_rad), 2.0
    state[3:6] = *level, angle_rad + math.pi
    state[12:] = vehicle.hover_rotor_speeds_hz
    return tuple(np.ravel(part) for part in effect(state, np.full(9, zeta)))


@pytest.mark.parametrize("angle_rad", [0.0, 1.0, -2.5])
def test_the_pull_at_the_reference_distance_is_the_one_asked_for(angle_rad):
    force, _ = wrench(Wall(suction_n=0.5), 0.35, angle_rad)
    inward = -np.array([math.cos(angle_rad), math.sin(angle_rad), 0.0])
    assert force @ inward == pytest.approx(0.5)
    np.testing.assert_allclose(force - (force @ inward) * inward, 0.0, atol=1e-12)


def test_far_away_nothing_is_left_and_it_falls_by_e_over_the_decay():
    wall = Wall(suction_n=1.0, thrust_loss=0.1)
    np.testing.assert_allclose(wrench(wall, 20.0), 0.0, atol=1e-12)
    near, far = (np.linalg.norm(wrench(Wall(suction_n=1.0), d)[0]) for d in (5.0, 5.3))
    assert near / far == pytest.approx(math.e, rel=1e-2)


def test_the_nearest_rotor_loses_its_share_of_thrust_at_the_wall():
    # With the hub of rotor 0 at the wall and all others too far to feel it.
    wall = Wall(thrust_loss=0.1, decay_m=0.01)
    force, torque = wrench(wall, 0.39, zeta=0.0)
    thrust = VEHICLE.force_coefficient_n_per_hz2 * HOVER[0] ** 2
    axis = VEHICLE.rotors[0].axis
    # Body to world is half a turn about z.
    np.testing.assert_allclose(force, -0.1 * thrust * axis * [-1, -1, 1], atol=1e-9)
    np.testing.assert_allclose(torque, -0.1 * thrust * np.cross([0.39, 0, 0], axis), atol=1e-9)


def test_the_loss_is_of_the_true_thrust():
    wall = Wall(thrust_loss=0.1)
    nominal, stronger = (wrench(wall, 0.35, zeta=share)[0][2] for share in (0.0, 0.1))
    assert stronger == pytest.approx(1.1 * nominal)
    assert -0.1 * VEHICLE.mass_kg * GRAVITY_M_S2 < nominal < 0.0


def test_the_vehicle_is_turned_by_the_pull_on_hubs_below_or_above_its_centre():
    raised = VEHICLE.model_copy(
        update={
            "rotors": tuple(
                rotor.model_copy(update={"position_m": (*rotor.position_m[:2], 0.1)})
                for rotor in VEHICLE.rotors
            )
        }
    )
    force, torque = wrench(Wall(suction_n=0.5), 0.35, vehicle=raised)
    # Nose towards the tower: a pull forward above the centre pitches down, positive about y.
    assert torque[1] == pytest.approx(0.1 * np.linalg.norm(force), rel=1e-9)
