# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Wind as a velocity field, against closed forms of the flow and the forces that follow."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gtmr_model import ConfigError, Helix, Tower, UncertaintySet, Vehicle
from gtmr_sim import Plant, Scenario, Simulation, World, fly
from gtmr_sim.worlds.wind import Wind, WindField, around_tower, far_wind, hover_drag, wake_deficit

VEHICLE, TOWER = Vehicle.paper(), Tower(radius_m=2.0)
START = Helix().initial_state(Tower(), VEHICLE)
ROUND = Wind(flow_around_tower=True)
FAR = np.array([3.0, 4.0, 0.5])
ZETA = np.array([0.05, 0.1, -0.1, 0.1, 0.05, 0.2, 0.5, -0.4, 0.1])


def at(angle_rad, radii, height_m=3.0):
    """A point by its angle from downwind."""
    downwind = math.atan2(FAR[1], FAR[0]) + angle_rad
    r = radii * TOWER.radius_m
    return np.array([r * math.cos(downwind), r * math.sin(downwind), height_m])


@given(st.floats(-math.pi, math.pi))
def test_no_air_flows_through_the_wall_and_it_is_twice_as_fast_beside_it(angle_rad):
    position = at(angle_rad, 1.0)
    flow = around_tower(ROUND, FAR, position, TOWER)
    assert flow[:2] @ position[:2] == pytest.approx(0.0, abs=1e-9)
    # |v| = 2 U |sin(theta)| on the surface of a cylinder.
    assert np.hypot(*flow[:2]) == pytest.approx(10.0 * abs(math.sin(angle_rad)), abs=1e-9)
    assert flow[2] == FAR[2]


def test_the_flow_is_that_of_the_potential_of_a_cylinder():
    # phi = U (x + R^2 x / r^2), along the wind.
    def potential(p):
        along = FAR[:2] / 5.0 @ p[:2]
        return 5.0 * along * (1.0 + TOWER.radius_m**2 / (p[:2] @ p[:2]))

    h = 1e-6
    for angle, radii in ((0.3, 1.2), (2.0, 1.5), (-1.0, 3.0)):
        p = at(angle, radii)
        gradient = [(potential(p + h * e) - potential(p - h * e)) / (2 * h) for e in np.eye(3)[:2]]
        flow = around_tower(ROUND, FAR, p, TOWER)
        np.testing.assert_allclose(flow[:2], gradient, rtol=1e-6)


def test_far_from_the_tower_the_wind_is_what_it_was():
    wind = Wind(flow_around_tower=True, wake=True)
    np.testing.assert_allclose(around_tower(wind, FAR, at(1.0, 1e4), TOWER), FAR, rtol=1e-6)
    np.testing.assert_array_equal(around_tower(Wind(), FAR, at(0.0, 1.1), TOWER), FAR)


def test_the_wake_is_that_of_powles():
    # Four radii behind, half-width sqrt(4) = 2 radii: C_d / 2 in the middle, none at the edge.
    assert wake_deficit(0.8, 4.0, 0.0) == pytest.approx(0.4)
    wide = (16.0 + 1.0) ** 0.25
    expected = 0.8 / wide * math.cos(0.5 * math.pi / wide) ** 2
    assert wake_deficit(0.8, 4.0, 1.0) == pytest.approx(expected)
    assert wake_deficit(0.8, 4.0, 2.5) == 0.0
    assert wake_deficit(0.8, -1.5, 0.0) == 0.0
    assert wake_deficit(5.0, 1.5, 0.0) == 1.0


def test_behind_the_tower_it_is_slower_by_the_wake_and_before_it_is_not():
    both = Wind(flow_around_tower=True, wake=True, tower_drag_coefficient=0.7)
    behind, before = at(0.0, 2.0), at(math.pi, 2.0)
    slowed = 1.0 - 0.7 / math.sqrt(2.0)
    without = around_tower(ROUND, FAR, behind, TOWER)
    np.testing.assert_allclose(
        around_tower(both, FAR, behind, TOWER)[:2], slowed * without[:2], atol=1e-12
    )
    np.testing.assert_array_equal(
        around_tower(both, FAR, before, TOWER), around_tower(ROUND, FAR, before, TOWER)
    )


def sampled(wind, zeta=ZETA, seed=0):
    return WindField(wind, zeta, VEHICLE, TOWER, np.random.default_rng(seed), 0.025, 2.0)


def test_the_mean_wind_grows_with_height_by_the_power_law():
    blown = sampled(Wind(speed_m_s=5.0, reference_height_m=10.0, profile_exponent=0.14))
    speeds = [np.hypot(*blown(np.array([9.0, 0.0, z]))[:2]) for z in (10.0, 2.0, 40.0, 0.0)]
    np.testing.assert_allclose(speeds, [5.0, 5.0 * 0.2**0.14, 5.0 * 4.0**0.14, 0.0])


@pytest.mark.slow
def test_turbulence_has_its_deviation_about_the_mean():
    blown = sampled(Wind(speed_m_s=8.0, turbulence_m_s=0.5))
    wind = np.array([blown(START[:3]) for _ in range(200_000)])
    np.testing.assert_allclose(wind[:, :2].std(axis=0), 0.5, rtol=0.06)
    assert np.hypot(*wind.mean(axis=0)[:2]) == pytest.approx(8.0, abs=0.05)


def test_a_speed_comes_with_a_direction_by_the_seed_and_takes_the_place_of_w_b():
    directions = {
        round(math.atan2(w[1], w[0]), 6)
        for w in (sampled(Wind(speed_m_s=5.0), seed=s)(START[:3]) for s in range(8))
    }
    assert len(directions) == 8
    calm = World(wind=Wind(speed_m_s=0.0))
    windless = ZETA.copy()
    windless[6:] = 0.0
    np.testing.assert_allclose(flown(calm, ZETA), flown(World(), windless), atol=1e-12)


def flown(world, zeta, x=START, air=None):
    plant = Plant(VEHICLE, zeta, x, 1e-3, world=world)
    if air is not None:
        plant.air_m_s = np.asarray(air)
    plant.advance(np.zeros(6), np.zeros(3), 200)
    return plant.x


@pytest.mark.parametrize("blades", [0.0, 5e-4])
def test_the_far_wind_pushes_as_w_b_does_and_no_force_is_counted_twice(blades):
    wind = Wind(blade_drag_n_s_per_m_hz=blades)
    air = far_wind(wind, ZETA, VEHICLE, np.random.default_rng(0))
    np.testing.assert_allclose(hover_drag(wind, ZETA, VEHICLE) @ air, ZETA[6:9], atol=1e-12)
    if blades == 0.0:
        np.testing.assert_allclose(air, ZETA[6:9] / (1.2 * VEHICLE.drag_n_s_per_m))
        np.testing.assert_allclose(
            flown(World(wind=wind), ZETA, air=air), flown(World(), ZETA), atol=1e-12
        )


def test_drag_is_on_the_velocity_relative_to_the_air():
    # A vehicle that drifts with the air feels neither body nor blades.
    drifting = START.copy()
    drifting[6:9] = 1.0, -2.0, 0.0
    zeta = np.zeros(9)
    blown = World(wind=Wind(blade_drag_n_s_per_m_hz=5e-4))
    unmoved = flown(blown, zeta, drifting, drifting[6:9])[6:9]
    np.testing.assert_allclose(unmoved, drifting[6:9], atol=1e-12)
    # At rest in it, the force is drag times wind: m v' = D w, one direction at a time.
    still = START.copy()
    still[6:9] = 0.0
    for blades in (0.0, 5e-4):
        wind = Wind(blade_drag_n_s_per_m_hz=blades)
        gained = flown(World(wind=wind), zeta, still, [1.0, 0.0, 0.0])[6:9]
        drag = hover_drag(wind, zeta, VEHICLE)[0, 0]
        # v = w (1 - exp(-D t / m))
        expected = 1.0 - math.exp(-drag * 0.2 / VEHICLE.mass_kg)
        assert gained[0] == pytest.approx(expected, rel=2e-3)


def test_blade_drag_of_the_papers_vehicle_at_hover():
    # c xi sum over rotors of (1 - z_x^2), where z_x^2 + z_y^2 = sin(20 deg)^2.
    xi = VEHICLE.hover_rotor_speeds_hz[0]
    expected = 0.1 + 5.07e-4 * xi * 6.0 * (1.0 - 0.5 * math.sin(math.radians(20.0)) ** 2)
    drag = hover_drag(Wind(blade_drag_n_s_per_m_hz=5.07e-4), np.zeros(9), VEHICLE)
    np.testing.assert_allclose(drag[0, 0], expected)
    # The mean wind of the world hard has its force at the edge of w_b.
    hard = World.load("world", "hard").wind
    force = hover_drag(hard, np.zeros(9), VEHICLE)[0, 0] * hard.speed_m_s
    assert force == pytest.approx(UncertaintySet().wind_bias_n[0], rel=0.01)


def test_a_vehicle_without_drag_is_no_sail():
    vehicle = VEHICLE.model_copy(update={"drag_n_s_per_m": 0.0})
    with pytest.raises(ConfigError, match="drag_n_s_per_m = 0"):
        Simulation(Scenario(vehicle=vehicle, world=World(wind=Wind())), 0.025)


class Holds:
    def step(self, t, x):
        return np.zeros(6)


def test_what_part_of_the_time_the_wind_is_within_its_bounds_is_told():
    scenario = Scenario(guard="hold", zeta=(*[0.0] * 6, 0.8, -0.8, 0.3), gust={"kind": "sinusoid"})
    within = fly(scenario, Holds(), 0.5)
    assert (within.steady_wind_within, within.gusts_within) == (1.0, 1.0)
    np.testing.assert_allclose(within.wind_n, np.tile([0.8, -0.8, 0.3], (20, 1)))

    strong = World(wind=Wind(speed_m_s=20.0))
    beyond = fly(scenario.model_copy(update={"world": strong}), Holds(), 0.5)
    assert (beyond.steady_wind_within, beyond.gusts_within) == (0.0, 1.0)
    np.testing.assert_allclose(np.linalg.norm(beyond.wind_n, axis=1), 2.0)
