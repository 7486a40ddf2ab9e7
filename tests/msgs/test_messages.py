# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Conversions between arrays and messages keep every number, in the right unit and frame."""

import math
from array import array

import casadi as ca
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from support.loop_messages import (
    odometry_message,
    path_message,
    rotor_command_message,
    rotor_states_message,
)
from trajectory_msgs.msg import JointTrajectory

from gtmr_model import CHANNELS, Helix, Tower
from gtmr_model.dynamics import ATTITUDE, rotation
from gtmr_msgs_py import topics
from gtmr_msgs_py.contract import Frames
from gtmr_msgs_py.messages import (
    clearance,
    odometry,
    path,
    rotor_command,
    rotor_states,
    solve_time,
    tightening,
)
from gtmr_msgs_py.node import diagnostics
from gtmr_msgs_py.node.diagnostics import Level
from gtmr_msgs_py.wire import attitude, stamps
from gtmr_msgs_py.wire.fixed_cdr import stamp_alone
from gtmr_msgs_py.wire.message_error import MessageError

finite = st.floats(-1e3, 1e3)
angle = st.floats(-20.0, 20.0)
pitch = st.floats(-1.5, 1.5)
attitudes = st.tuples(angle, pitch, angle).map(np.array)
stamp = st.integers(0, 2**31 * stamps.NANOSECONDS - 1)


def wire(message):
    """What a raw subscriber gets; also refuses fields of a wrong type."""
    return serialize_message(message)


def over_the_wire(message):
    """What a subscriber gets."""
    return deserialize_message(wire(message), type(message))


def assert_same(one, other):
    """Equal to the last bit, whatever holds the arrays."""
    np.testing.assert_equal(one, other)


def model_rotation(eta):
    """The rotation that the equations of motion use."""
    return np.asarray(rotation(ca.DM(eta)))


def turn(quaternion, vector):
    """Turn a vector by q v q*, Hamilton's product written out."""
    axis, w = np.array([quaternion.x, quaternion.y, quaternion.z]), quaternion.w
    return vector + 2.0 * np.cross(axis, np.cross(axis, vector) + w * vector)


def wrapped(angle_rad):
    return math.remainder(angle_rad, 2.0 * math.pi)


@given(stamp)
def test_a_stamp_keeps_every_nanosecond(time_ns):
    assert stamps.decode(over_the_wire(stamps.encode(time_ns))) == time_ns


@given(st.integers(0, 10**15))
def test_seconds_are_those_nearest_to_the_nanoseconds(time_ns):
    assert stamps.nanoseconds(stamps.seconds(time_ns)) == time_ns


@given(attitudes, arrays(float, 3, elements=finite))
def test_the_quaternion_turns_vectors_as_the_equations_of_motion_do(eta, vector):
    expected = model_rotation(eta) @ vector
    assert turn(attitude.encode(eta), vector) == pytest.approx(expected, abs=1e-9)


@given(attitudes)
def test_attitude_comes_back_but_for_whole_turns(eta):
    back = attitude.roll_pitch_yaw(attitude.rotation(attitude.encode(eta)))
    for there, here in zip(eta, back, strict=True):
        assert wrapped(there - here) == pytest.approx(0.0, abs=1e-9)


@given(stamp, arrays(float, 12, elements=finite), attitudes)
def test_a_state_comes_back_from_odometry(time_ns, x, eta):
    x[ATTITUDE] = eta
    stamp_ns, back = odometry.decode(over_the_wire(odometry_message(time_ns, x)))
    x[ATTITUDE] = back[ATTITUDE]
    assert stamp_ns == time_ns
    assert back == pytest.approx(x, abs=1e-9)


@given(attitudes, arrays(float, 3, elements=finite))
def test_the_twist_of_odometry_is_in_the_child_frame(eta, velocity):
    x = np.r_[np.zeros(3), eta, velocity, np.zeros(3)]
    msg = deserialize_message(odometry.pack(0, x), Odometry)
    linear = msg.twist.twist.linear
    in_body = model_rotation(eta).T @ velocity
    assert [linear.x, linear.y, linear.z] == pytest.approx(in_body, abs=1e-9)
    assert (msg.header.frame_id, msg.child_frame_id) == ("map", "base_link")


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_odometry_that_is_not_finite_is_refused(bad):
    msg = odometry_message(0, np.zeros(12))
    msg.pose.pose.position.y = bad
    with pytest.raises(MessageError, match="not finite"):
        odometry.decode(msg)


@pytest.mark.parametrize("w", [0.0, 0.5, math.nan])
def test_an_orientation_that_is_no_unit_quaternion_is_refused(w):
    msg = odometry_message(0, np.zeros(12))
    msg.pose.pose.orientation.w = w
    with pytest.raises(MessageError, match="no unit quaternion"):
        odometry.decode(msg)


@given(stamp, arrays(float, st.integers(1, 12), elements=st.floats(0.0, 200.0)))
def test_rotor_speeds_come_back(time_ns, xi):
    msg = over_the_wire(rotor_states_message(time_ns, xi))
    stamp_ns, back = rotor_states.decode(msg, len(xi))
    assert stamp_ns == time_ns
    assert back == pytest.approx(xi, abs=1e-12)


def test_one_turn_a_second_is_two_pi_radians_a_second():
    assert deserialize_message(rotor_states.pack(0, [1.0]), JointState).velocity[0] == math.tau
    command = rotor_command.pack(0, 1, [[1.0], [1.0]], [[1.0]])
    point = deserialize_message(command, JointTrajectory).points[0]
    assert point.velocities[0] == point.accelerations[0] == math.tau


def test_rotors_are_told_apart_by_their_names():
    msg = rotor_states_message(0, [10.0, 20.0, 30.0])
    msg.name, msg.velocity = list(reversed(msg.name)), list(reversed(msg.velocity))
    assert rotor_states.decode(msg, 3)[1] == pytest.approx([10.0, 20.0, 30.0])


def test_rotor_states_of_another_vehicle_are_refused():
    with pytest.raises(MessageError, match="4 speeds"):
        rotor_states.decode(rotor_states_message(0, np.ones(4)), 6)


@given(st.integers(1, 30), st.integers(1, 8), stamp, st.integers(1, 10**9))
def test_a_plan_comes_back_from_a_command(n, n_rotors, time_ns, step_ns):
    rng = np.random.default_rng(n)
    xi, u = rng.normal(60.0, 10.0, (n + 1, n_rotors)), rng.normal(0.0, 100.0, (n, n_rotors))
    msg = over_the_wire(rotor_command_message(time_ns, step_ns, xi, u))
    plan = rotor_command.decode(msg, n_rotors)
    assert (plan.stamp_ns, plan.step_ns) == (time_ns, step_ns)
    assert plan.xi == pytest.approx(xi)
    assert plan.u == pytest.approx(u)
    assert not np.any(msg.points[-1].accelerations)


def test_a_command_with_uneven_points_is_refused():
    msg = rotor_command_message(0, 100, np.ones((4, 6)), np.ones((3, 6)))
    msg.points[2].time_from_start.nanosec = 150
    with pytest.raises(MessageError, match="even spacing"):
        rotor_command.decode(msg, 6)


@pytest.mark.parametrize("n_rotors", [4, 8])
def test_a_command_for_another_vehicle_is_refused(n_rotors):
    msg = rotor_command_message(0, 100, np.ones((4, 6)), np.ones((3, 6)))
    with pytest.raises(MessageError, match="rotor_command"):
        rotor_command.decode(msg, n_rotors)


def test_a_path_says_when_it_is_where():
    reference = Helix().at([3.0, 3.5, 4.0], Tower())
    angles = np.zeros((3, 3))
    angles[:, 2] = reference.yaw
    packed = path.pack(3 * 10**9, 5 * 10**8, reference.position, angles)
    msg = deserialize_message(packed, Path)
    times, positions = path.decode(msg)
    assert times.tolist() == [3 * 10**9, 35 * 10**8, 4 * 10**9]
    assert positions == pytest.approx(reference.position)
    facing = turn(msg.poses[0].pose.orientation, np.array([1.0, 0.0, 0.0]))
    assert facing[:2] == pytest.approx(-positions[0, :2] / np.hypot(*positions[0, :2]))


def test_margins_come_back_under_their_labels():
    rng = np.random.default_rng(0)
    terms, alpha_g, slack = rng.random((21, 9)), rng.random(21), rng.random(21)
    packed = tightening.pack(terms, 1e-3, alpha_g, slack)
    msg = deserialize_message(packed, Float64MultiArray)
    stage, columns = msg.layout.dim
    assert (stage.label, stage.size, stage.stride) == ("stage", 21, 21 * 12)
    assert columns.label.split(",") == [*CHANNELS, "eps_s", "alpha_g", "slack"]
    assert (columns.size, columns.stride) == (12, 12)
    back = tightening.decode(msg)
    assert back.alpha_p == pytest.approx(terms.sum(axis=1) + 1e-3)
    assert back.alpha_g == pytest.approx(alpha_g)
    assert back.slack == pytest.approx(slack)


def test_margins_under_other_labels_are_refused():
    packed = tightening.pack(np.zeros((2, 9)), 0.0, np.zeros(2), np.zeros(2))
    msg = deserialize_message(packed, Float64MultiArray)
    msg.layout.dim[1].label = "x,y"
    with pytest.raises(MessageError, match="labelled"):
        tightening.decode(msg)


@pytest.mark.parametrize("clearance_m", [0.35, 0.15, 0.0, -0.9])
def test_no_clearance_is_out_of_range_and_all_have_a_width(clearance_m):
    msg = over_the_wire(clearance.encode(7, clearance_m))
    assert msg.range == pytest.approx(clearance_m, abs=1e-7)
    assert msg.min_range < msg.range < msg.max_range
    assert msg.field_of_view > 0.0


def test_a_residual_is_in_metres():
    assert over_the_wire(clearance.encode_residual(-0.15)).data == -0.15


def test_a_solve_time_is_in_seconds():
    assert over_the_wire(solve_time.encode(np.float64(0.004))).data == 0.004


def test_figures_come_back_from_diagnostics_as_what_they_are():
    values = {"mode": "robust", "steps": 12, "solve_ms": 3.25, "recording": True}
    msg = deserialize_message(
        diagnostics.pack(5, "nmpc: controller", Level.WARN, "late", values, "paper"),
        DiagnosticArray,
    )
    assert stamps.decode(msg.header.stamp) == 5
    (status,) = msg.status
    assert (status.name, status.hardware_id) == ("nmpc: controller", "paper")
    assert (status.level, status.message) == (b"\x01", "late")
    assert diagnostics.decode(status) == values


@given(stamp)
def test_a_clock_is_a_stamp_alone(time_ns):
    assert stamps.decode(deserialize_message(stamp_alone(time_ns), Clock).clock) == time_ns


def test_every_topic_is_named_once_and_described():
    names = [topic.name for topic in topics.TOPICS]
    assert len(set(names)) == len(names)
    assert all(topic.content and topic.publishers for topic in topics.TOPICS)
    assert topics.ODOM.type_name == "nav_msgs/msg/Odometry"
    assert topics.RESET.type_name == "std_srvs/srv/Trigger"


@given(stamp, arrays(float, 12, elements=finite), attitudes)
def test_packed_odometry_is_the_message_and_reads_as_it_does(time_ns, x, eta):
    x[ATTITUDE] = eta
    data = odometry.pack(time_ns, x)
    msg = deserialize_message(data, Odometry)
    assert msg == odometry_message(time_ns, x)
    assert_same(odometry.unpack(data), odometry.decode(msg))


@given(stamp, arrays(float, st.integers(1, 12), elements=st.floats(0.0, 200.0)))
def test_packed_rotor_states_are_the_message_and_read_as_it_does(time_ns, xi):
    data = rotor_states.pack(time_ns, xi)
    msg = deserialize_message(data, JointState)
    assert msg == rotor_states_message(time_ns, xi)
    assert_same(rotor_states.unpack(data, len(xi)), rotor_states.decode(msg, len(xi)))


@given(st.data(), st.integers(1, 8), st.integers(1, 25))
def test_packed_commands_are_the_message_and_read_as_it_does(data, n_rotors, horizon):
    reader = rotor_command.Reader(n_rotors)
    step_ns = data.draw(st.integers(1, 10**9))
    # The first is read as any message, those after it are known by their shape.
    for _ in range(3):
        xi = data.draw(arrays(float, (horizon + 1, n_rotors), elements=finite))
        u = data.draw(arrays(float, (horizon, n_rotors), elements=finite))
        command = data.draw(stamp), step_ns, xi, u
        packed = rotor_command.pack(*command)
        msg = deserialize_message(packed, JointTrajectory)
        assert msg == rotor_command_message(*command)
        assert_same(vars(reader.unpack(packed)), vars(rotor_command.decode(msg, n_rotors)))


@given(st.data(), st.integers(0, 8), st.integers(0, 2**30 * stamps.NANOSECONDS))
def test_packed_paths_are_the_message(data, n_poses, time_ns):
    step_ns = data.draw(st.integers(1, 10**9))
    positions, rpy = (data.draw(arrays(float, (n_poses, 3), elements=finite)) for _ in range(2))
    expected = path_message(time_ns, step_ns, positions, rpy)
    # Attitudes may differ in their last digit.
    msg = deserialize_message(path.pack(time_ns, step_ns, positions, rpy), Path)
    for pose, found in zip(expected.poses, msg.poses, strict=True):
        q, q_found = pose.pose.orientation, found.pose.orientation
        assert vector_of(q_found) == pytest.approx(vector_of(q), abs=1e-15)
        pose.pose.orientation = q_found
    assert msg == expected


def vector_of(quaternion):
    return [quaternion.x, quaternion.y, quaternion.z, quaternion.w]


def test_packed_messages_are_read_by_a_strict_reader_too():
    types = get_typestore(Stores.ROS2_JAZZY)
    command = rotor_command.pack(7, 100, np.ones((4, 6)), np.ones((3, 6)))
    for data, name in [
        (odometry.pack(7, np.zeros(12)), "nav_msgs/msg/Odometry"),
        (rotor_states.pack(7, np.ones(6)), "sensor_msgs/msg/JointState"),
        (command, "trajectory_msgs/msg/JointTrajectory"),
        (path.pack(7, 100, np.zeros((2, 3)), np.zeros((2, 3))), "nav_msgs/msg/Path"),
    ]:
        assert types.deserialize_cdr(data, name).header.stamp.nanosec == 7


def test_what_others_send_is_read_whatever_its_shape():
    estimated = odometry_message(5, np.arange(12.0) / 10.0)
    estimated.header.frame_id, theirs = "odom", Frames("odom")
    estimated.pose.covariance[0] = 0.25
    speeds = rotor_states_message(5, [1.0, 2.0, 3.0])
    speeds.name.reverse()
    plan = rotor_command_message(5, 100, np.ones((4, 3)), np.ones((3, 3)))
    plan.points[2].effort = array("d", [1.0])
    reader = rotor_command.Reader(3)
    for _ in range(2):
        assert_same(odometry.unpack(wire(estimated), theirs), odometry.decode(estimated))
        assert_same(rotor_states.unpack(wire(speeds), 3), rotor_states.decode(speeds, 3))
        assert_same(vars(reader.unpack(wire(plan))), vars(rotor_command.decode(plan, 3)))


def exchange(data, one, other):
    """Exchange two words of the same length in the bytes of a message."""
    assert len(one) == len(other)
    at_one, at_other = data.index(one), data.index(other)
    swapped = bytearray(data)
    swapped[at_one : at_one + len(one)] = other
    swapped[at_other : at_other + len(other)] = one
    return bytes(swapped)


def test_another_layout_of_the_same_length_is_not_taken_for_ours():
    ours = rotor_states.pack(5, [1.0, 2.0, 3.0])
    reversed_names = exchange(ours, b"rotor_0", b"rotor_2")
    assert rotor_states.unpack(reversed_names, 3)[1] == pytest.approx([3.0, 2.0, 1.0])

    xi, u = np.ones((4, 3)), np.ones((3, 3))
    slow, fast = rotor_command.pack(5, 200, xi, u), rotor_command.pack(5, 100, xi, u)
    assert len(slow) == len(fast)
    reader = rotor_command.Reader(3)
    assert [reader.unpack(data).step_ns for data in (fast, slow, slow, fast)] == [
        100,
        200,
        200,
        100,
    ]
    with pytest.raises(MessageError, match=r"rotor_2.*rotor_1.*rotor_0"):
        reader.unpack(exchange(fast, b"rotor_0", b"rotor_2"))


def test_a_packed_command_is_refused_for_what_a_message_is_refused_for():
    reader = rotor_command.Reader(6)
    reader.unpack(rotor_command.pack(0, 100, np.ones((4, 6)), np.ones((3, 6))))
    spoilt = np.ones((4, 6))
    spoilt[2, 3] = math.nan
    with pytest.raises(MessageError, match="not finite"):
        reader.unpack(rotor_command.pack(0, 100, spoilt, np.ones((3, 6))))
    with pytest.raises(MessageError, match="rotor_5"):
        reader.unpack(rotor_command.pack(0, 100, np.ones((4, 5)), np.ones((3, 5))))
    with pytest.raises(MessageError, match="not finite"):
        odometry.unpack(odometry.pack(0, np.r_[math.inf, np.zeros(11)]))
    with pytest.raises(MessageError, match="not finite"):
        rotor_states.unpack(rotor_states.pack(0, [math.nan, 1.0]), 2)
