# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The views show what the nodes publish: markers, transform, RViz configuration."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import yaml
from rclpy.serialization import deserialize_message, serialize_message
from visualization_msgs.msg import Marker

from gtmr_model import Tower, Vehicle
from gtmr_model.dynamics import rotation
from gtmr_monitor.bag.format import typestore
from gtmr_monitor.report import look
from gtmr_msgs_py import contract, topics
from gtmr_msgs_py.messages import markers, transforms
from gtmr_msgs_py.wire import attitude

VIEWS = Path(__file__).parents[2] / "rviz"
NAMES = {topic.name.lstrip("/") for topic in topics.TOPICS}
ETA = np.array([0.1, -0.2, 2.0])
STATE = np.r_[1.0, 2.0, 3.0, ETA, np.zeros(6), 50.0, 60.0, 70.0, 80.0, 90.0, 100.0]
MARGINS = np.linspace(0.0, 0.1, 21)
HEIGHTS = np.linspace(3.0, 3.02, 21)


def over_the_wire(message):
    """What a subscriber gets; also refuses fields of a wrong type."""
    return deserialize_message(serialize_message(message), type(message))


def body_to_world():
    """The rotation that the equations of motion use."""
    return np.asarray(rotation(ca.DM(ETA)))


def of(namespace, drawn):
    return [marker for marker in over_the_wire(markers.encode(0, drawn)).markers
            if marker.ns == namespace]  # fmt: skip


def xyz(point):
    return np.array([point.x, point.y, point.z])


def everything():
    tower, vehicle = Tower(), Vehicle.paper()
    return [
        *markers.tower(tower),
        *markers.tightened_shells(tower, MARGINS, HEIGHTS, "robust"),
        *markers.plan(np.zeros((21, 3)), "robust"),
        *markers.vehicle(vehicle, STATE),
        *markers.guard(STATE[:3], "plan ended"),
    ]


def test_the_drawn_rotors_sit_and_tilt_where_the_vehicle_has_them():
    vehicle = Vehicle.paper()
    discs = of("propellers", markers.vehicle(vehicle, STATE))
    assert len(discs) == vehicle.n_rotors
    for disc, rotor in zip(discs, vehicle.rotors, strict=True):
        hub = STATE[:3] + body_to_world() @ rotor.position_m
        assert xyz(disc.pose.position) == pytest.approx(hub)
        assert (disc.scale.x, disc.scale.y) == (2.0 * vehicle.rotor_radius_m,) * 2
        up = attitude.rotation(disc.pose.orientation) @ (0.0, 0.0, 1.0)
        assert up == pytest.approx(body_to_world() @ rotor.axis)


def test_thrust_is_drawn_from_the_hub_along_the_axis_in_proportion_to_thrust():
    vehicle = Vehicle.paper()
    arrows = of("thrust", markers.vehicle(vehicle, STATE))
    thrusts_n = vehicle.force_coefficient_n_per_hz2 * STATE[12:] ** 2
    for arrow, rotor, thrust_n in zip(arrows, vehicle.rotors, thrusts_n, strict=True):
        tail, tip = map(xyz, arrow.points)
        assert tail == pytest.approx(STATE[:3] + body_to_world() @ rotor.position_m)
        expected = markers.DRAWN_THRUST_M_PER_N * thrust_n * body_to_world() @ rotor.axis
        assert tip - tail == pytest.approx(expected)


def test_without_rotor_speeds_no_thrust_is_drawn():
    assert not of("thrust", markers.vehicle(Vehicle.paper(), STATE[:12]))


def test_shells_are_drawn_at_their_radius():
    tower = Tower()
    radii = {marker.ns: 0.5 * marker.scale.x for marker in markers.tower(tower)}
    assert radii == pytest.approx({"tower": 1.0, "d_min": 1.2})
    shells = markers.tightened_shells(tower, MARGINS, HEIGHTS, "robust")
    (shell,) = of("tightened", shells)
    assert 0.5 * shell.scale.x == pytest.approx(1.3)
    assert shell.header.frame_id == "map"


def test_each_stage_has_a_collar_at_its_own_radius_and_height():
    collars = of("tightened_stages", markers.tightened_shells(Tower(), MARGINS, HEIGHTS, "robust"))
    assert [0.5 * collar.scale.x for collar in collars] == pytest.approx(1.2 + MARGINS)
    assert [collar.pose.position.z for collar in collars] == pytest.approx(HEIGHTS)
    assert len({collar.id for collar in collars}) == len(MARGINS)


@pytest.mark.parametrize("mode", look.MODE_COLOURS)
def test_a_mode_has_the_colour_that_it_has_in_the_report(mode):
    (line,) = markers.plan(np.zeros((21, 3)), mode)
    assert line.type == Marker.LINE_STRIP
    assert len(line.points) == 21
    parts = line.color.r, line.color.g, line.color.b
    assert "#" + "".join(f"{round(255 * part):02X}" for part in parts) == look.MODE_COLOURS[mode]


def test_the_guard_is_named_above_the_vehicle_while_it_is_in_charge():
    (text,), (gone,) = markers.guard(STATE[:3], "plan ended"), markers.guard(STATE[:3], "")
    assert (text.text, text.action, gone.action) == (
        "guard: plan ended",
        Marker.ADD,
        Marker.DELETE,
    )
    assert text.pose.position.z > STATE[2]


def test_every_namespace_that_is_drawn_is_listed():
    assert {marker.ns for marker in everything()} == set(markers.NAMESPACES)


def transform_in(data):
    """What a reader that is not ours takes the bytes for."""
    message = typestore().deserialize_cdr(data, contract.TF.type_name)
    assert typestore().serialize_cdr(message, contract.TF.type_name).tobytes() == data
    (transform,) = message.transforms
    return transform


def test_the_transform_is_the_pose_of_base_link_in_map():
    message = transform_in(transforms.pack(3_000_000_007, STATE))
    assert (message.header.frame_id, message.child_frame_id) == ("map", "base_link")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 7)
    assert xyz(message.transform.translation) == pytest.approx(STATE[:3])
    assert attitude.rotation(message.transform.rotation) == pytest.approx(body_to_world())


def test_a_frame_of_any_name_has_a_transform():
    message = transform_in(transforms.pack(0, STATE, contract.Frames("earth", "hexarotor_12")))
    assert (message.header.frame_id, message.child_frame_id) == ("earth", "hexarotor_12")
    assert xyz(message.transform.translation) == pytest.approx(STATE[:3])


def test_the_tower_stands_where_the_world_begins():
    message = transform_in(transforms.pack_tower())
    assert (message.header.frame_id, message.child_frame_id) == ("map", contract.TOWER_FRAME)
    assert not xyz(message.transform.translation).any()
    assert attitude.rotation(message.transform.rotation) == pytest.approx(np.eye(3))


def test_tf_is_a_topic_where_tf2_messages_are_installed():
    pytest.importorskip("tf2_msgs", reason="tf2_msgs is not installed")
    assert topics.TF in topics.TOPICS
    message = deserialize_message(transforms.pack(7, STATE), topics.TF.message)
    assert [each.child_frame_id for each in message.transforms] == ["base_link"]


@pytest.fixture(scope="module")
def rviz():
    return yaml.safe_load((VIEWS / "inspection.rviz").read_text())["Visualization Manager"]


def test_rviz_shows_topics_that_exist(rviz):
    displays = [display for display in rviz["Displays"] if "Topic" in display]
    shown = [display["Topic"]["Value"] for display in displays]
    assert set(shown) <= NAMES
    assert set(shown) == {"markers", "reference", "predicted_path", "odom"}


def test_rviz_shows_every_namespace(rviz):
    (display,) = (each for each in rviz["Displays"] if each["Class"].endswith("/MarkerArray"))
    assert display["Namespaces"] == dict.fromkeys(markers.NAMESPACES, True)
    assert rviz["Global Options"]["Fixed Frame"] == contract.MAP
