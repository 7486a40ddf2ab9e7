# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Equations of motion against mechanics written down independently."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gtmr_model import UncertaintySet, Vehicle, dynamics
from gtmr_model.dynamics import rk4_step
from gtmr_model.vehicle import GRAVITY_M_S2

VEHICLES = [Vehicle.preset("vehicle", name) for name in ("paper", "laas", "octo", "quad")]


def vectors(n, bound):
    return st.lists(st.floats(-bound, bound), min_size=n, max_size=n).map(np.array)


@st.composite
def situations(draw):
    """Vehicle, state, input, zeta and gust."""
    vehicle = draw(st.sampled_from(VEHICLES))
    n = vehicle.n_rotors
    x = np.concatenate(
        [
            draw(vectors(3, 5.0)),
            draw(vectors(3, 1.4)),
            draw(vectors(3, 3.0)),
            draw(vectors(3, 2.0)),
            60.0 + draw(vectors(n, 40.0)),
        ]
    )
    zeta = draw(vectors(9, 1.0)) * UncertaintySet().half_widths
    return vehicle, x, draw(vectors(n, 200.0)), zeta, draw(vectors(3, 0.5))


@given(situations())
def test_newton_and_euler_hold(situation):
    vehicle, x, u, zeta, w_g = situation
    x_dot = dynamics(x, u, zeta, w_g, vehicle)
    v, omega, xi = x[6:9], x[9:12], x[12:]

    body_to_world = Rotation.from_euler("ZYX", x[5:2:-1])
    mass = vehicle.mass_kg * (1 + zeta[0])
    inertia = np.array(vehicle.inertia_kg_m2) * (1 + zeta[1:4])
    force, torque = np.zeros(3), np.zeros(3)
    for rotor, speed in zip(vehicle.rotors, xi, strict=True):
        thrust = (1 + zeta[4]) * vehicle.force_coefficient_n_per_hz2 * speed**2 * rotor.axis
        drag = (1 + zeta[4]) * vehicle.torque_coefficient_nm_per_hz2 * speed**2 * rotor.axis
        force += thrust
        torque += np.cross(rotor.position_m, thrust) + (drag if rotor.spin == "cw" else -drag)

    momentum_rate = body_to_world.apply(force) - mass * np.array([0, 0, GRAVITY_M_S2])
    momentum_rate += -vehicle.drag_n_s_per_m * (1 + zeta[5]) * v + zeta[6:] + w_g
    np.testing.assert_allclose(x_dot[:3], v)
    np.testing.assert_allclose(mass * x_dot[6:9], momentum_rate, atol=1e-9)
    np.testing.assert_allclose(
        inertia * x_dot[9:12], torque - np.cross(omega, inertia * omega), atol=1e-9
    )
    np.testing.assert_allclose(x_dot[12:], u)


@given(situations())
def test_euler_rates_turn_the_body_as_its_angular_velocity_does(situation):
    vehicle, x, u, zeta, w_g = situation
    eta_rate = dynamics(x, u, zeta, w_g, vehicle)[3:6]
    step = 1e-6
    before = Rotation.from_euler("ZYX", (x[3:6] - 0.5 * step * eta_rate)[::-1])
    after = Rotation.from_euler("ZYX", (x[3:6] + 0.5 * step * eta_rate)[::-1])
    turned = (before.inv() * after).as_rotvec() / step
    np.testing.assert_allclose(turned, x[9:12], atol=1e-4)


def test_free_fall_and_hover():
    vehicle = Vehicle.paper()
    x = np.zeros(18)
    nothing = np.zeros(6), np.zeros(9), np.zeros(3)
    assert dynamics(x, *nothing, vehicle)[8] == pytest.approx(-GRAVITY_M_S2)
    x[12:] = vehicle.hover_rotor_speeds_hz
    np.testing.assert_allclose(dynamics(x, *nothing, vehicle), 0.0, atol=1e-12)


@pytest.mark.parametrize("name", ["x", "u", "zeta", "w_g"])
def test_wrong_length_is_refused_by_name(name):
    arguments = {"x": np.zeros(18), "u": np.zeros(6), "zeta": np.zeros(9), "w_g": np.zeros(3)}
    arguments[name] = np.zeros(2)
    with pytest.raises(ValueError, match=f"^{name} has shape"):
        dynamics(**arguments, vehicle=Vehicle.paper())


def test_rk4_converges_with_fourth_order():
    def error(steps):
        x = np.array([1.0, 0.0])
        for _ in range(steps):
            x = rk4_step(x, 1.0 / steps, lambda x: np.array([x[1], -x[0]]))
        return np.linalg.norm(x - [np.cos(1.0), -np.sin(1.0)])

    assert error(10) / error(20) == pytest.approx(16.0, rel=0.05)
