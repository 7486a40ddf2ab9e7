# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The vehicle: allocation, hover, presets, and clear refusals."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from gtmr_model import ConfigError, Vehicle
from gtmr_model.vehicle import GRAVITY_M_S2


def test_paper_tilt_hex_is_fully_actuated_and_hovers_at_the_published_speed():
    vehicle = Vehicle.paper()
    assert np.linalg.matrix_rank(vehicle.allocation) == 6
    assert np.linalg.cond(vehicle.allocation) == pytest.approx(6.1, abs=0.05)
    np.testing.assert_allclose(vehicle.hover_rotor_speeds_hz, 61.56, atol=0.005)


def test_paper_rotor_axes_are_rz_azimuth_rx_tilt_with_alternating_sign():
    for i, rotor in enumerate(Vehicle.paper().rotors):
        axis = Rotation.from_euler("ZX", [60.0 * i, -20.0 * (-1) ** i], degrees=True)
        np.testing.assert_allclose(rotor.axis, axis.apply([0.0, 0.0, 1.0]), atol=1e-12)
        place = Rotation.from_euler("Z", 60.0 * i, degrees=True).apply([0.39, 0.0, 0.0])
        np.testing.assert_allclose(rotor.position_m, place, atol=1e-12)
        assert rotor.spin == ("cw", "ccw")[i % 2]


def test_cant_turns_the_axis_outward_about_the_tangent():
    rotor = Vehicle.paper().rotors[2].model_copy(update={"tilt_deg": 15.0, "cant_deg": 10.0})
    axis = Rotation.from_euler("ZXY", [120.0, 15.0, 10.0], degrees=True)
    np.testing.assert_allclose(rotor.axis, axis.apply([0.0, 0.0, 1.0]), atol=1e-12)


@pytest.mark.parametrize(("name", "n_rotors"), [("laas", 6), ("octo", 8), ("quad", 4)])
def test_presets_hover_on_their_own_thrust(name, n_rotors):
    vehicle = Vehicle.preset("vehicle", name)
    assert vehicle.n_rotors == n_rotors
    wrench = vehicle.allocation @ vehicle.hover_rotor_speeds_hz**2
    weight = [0, 0, vehicle.mass_kg * GRAVITY_M_S2, 0, 0, 0]
    np.testing.assert_allclose(wrench, weight, atol=1e-9)


def edited(tmp_path, **changes):
    """Write the paper's vehicle with some fields changed; None removes a field."""
    data = Vehicle.paper().model_dump(mode="json") | changes
    path = tmp_path / "vehicle.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in data.items() if v is not None}))
    return path


def test_yaml_round_trip(tmp_path):
    assert Vehicle.from_yaml(edited(tmp_path)) == Vehicle.paper()


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"mass_kg": None}, "mass_kg is missing"),
        ({"mass_kg": -1.0}, "mass_kg = -1.0"),
        ({"mass": 2.0}, "mass is not a known field"),
        ({"inertia_kg_m2": [0.1, 0.1]}, "inertia_kg_m2"),
        ({"rotors": []}, "rotors"),
        ({"rotors": [{"position_m": [1, 0, 0], "spin": "left"}]}, "rotors.0.spin = 'left'"),
        ({"mass_kg": 30.0}, "hover"),
        ({"min_rotor_speed_hz": 120.0}, "min_rotor_speed_hz"),
        ({"drag_n_s_per_m": float("nan")}, "drag_n_s_per_m"),
    ],
)
def test_wrong_yaml_is_refused_in_one_line_that_names_the_field(tmp_path, changes, named):
    with pytest.raises(ConfigError) as refusal:
        Vehicle.from_yaml(edited(tmp_path, **changes))
    message = str(refusal.value)
    assert named in message
    assert "vehicle.yaml" in message
    assert "\n" not in message


@pytest.mark.parametrize("content", ["- 1\n- 2\n", "a: [1", "", "\x00"])
def test_file_that_is_no_vehicle_is_refused(tmp_path, content):
    path = tmp_path / "broken.yaml"
    path.write_text(content)
    with pytest.raises(ConfigError, match=r"broken\.yaml"):
        Vehicle.from_yaml(path)


def test_unknown_preset_lists_the_known_ones():
    with pytest.raises(ConfigError, match="laas, octo, paper, quad"):
        Vehicle.load("vehicle", "hexa")
