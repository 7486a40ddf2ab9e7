# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A replay gives what the node gave, and says what it had to guess."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from scipy.spatial.transform import Rotation
from support.damage import damage_chunks
from support.recorded_flight import recorded
from support.written_bags import ODOMETRY, SAMPLE, STORE, copied, new

from gtmr_model import Helix, Tower, Vehicle, dynamics
from gtmr_model.dynamics import RATE, ROTORS, VELOCITY
from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.vehicles import read_recording
from gtmr_monitor.bag.writer import BagWriter
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_study.ros.replay import replay
from gtmr_study.ros.replay.parameters import RecordedParameters
from gtmr_study.ros.replay.rotor_speeds import quasi_static_rotor_speeds

START = Helix().initial_state(Tower(), Vehicle.paper())
JOINT_STATE = "sensor_msgs/msg/JointState"
EXACT = 1e-9
"""[Hz/s]"""
UNIX_NS = 1_750_000_000 * 10**9
ODOM_A_STEP = 5
"""Odometry messages a step in the sample bag: 200 Hz, with T_s of 25 ms."""


def leaving_out(topic):
    return lambda messages: [message for message in messages if message.topic != topic]


def header(stamp_ns, frame):
    stamp = new("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
    return new("std_msgs/msg/Header", stamp, frame)


def foreign_odometry(stamp_ns, x):
    """Odometry as another estimator sends it: other frames, and a covariance."""
    turn = Rotation.from_euler("ZYX", x[5:2:-1])
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    pose = new(
        "geometry_msgs/msg/Pose",
        new("geometry_msgs/msg/Point", *map(float, x[:3])),
        new("geometry_msgs/msg/Quaternion", *turn.as_quat()),
    )
    twist = new("geometry_msgs/msg/Twist", vector(*turn.inv().apply(x[6:9])), vector(*x[9:12]))
    covariance = 0.01 * np.eye(6).ravel()
    return new(
        ODOMETRY,
        header(stamp_ns, "world"),
        "drone",
        new("geometry_msgs/msg/PoseWithCovariance", pose, covariance),
        new("geometry_msgs/msg/TwistWithCovariance", twist, covariance),
    )


def foreign_rotors(stamp_ns, xi):
    nothing = np.zeros(0)
    names = [f"motor{i}" for i in range(len(xi))]
    return new(JOINT_STATE, header(stamp_ns, ""), names, nothing, 2 * np.pi * xi, nothing)


def along_the_helix(time_s):
    """A state that follows the reference."""
    x, at = START.copy(), Helix().at(time_s, Tower())
    x[:3], x[5], x[VELOCITY] = at.position[0], at.yaw[0], at.velocity[0]
    return x


@pytest.fixture
def foreign(tmp_path):
    """Write 2 s of somebody else's flight at 20 Hz with rosbags; optionally its rotor speeds."""

    def write(rotor_period_ns=None, rotors="/drone/motors"):
        path = tmp_path / "foreign"
        writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer as bag:
            odom = bag.add_connection("/drone/state", ODOMETRY, typestore=STORE)
            speeds = bag.add_connection(rotors, JOINT_STATE, typestore=STORE)
            for since_ns in range(0, 2 * 10**9, 5_000_000):
                at_ns, x = UNIX_NS + since_ns, along_the_helix(1e-9 * since_ns)
                if since_ns % 50_000_000 == 0:
                    message = foreign_odometry(at_ns, x)
                    bag.write(odom, at_ns, STORE.serialize_cdr(message, ODOMETRY))
                if rotor_period_ns and (since_ns + 5_000_000) % rotor_period_ns == 0:
                    message = foreign_rotors(at_ns, x[ROTORS])
                    bag.write(speeds, at_ns, STORE.serialize_cdr(message, JOINT_STATE))
        return path

    return write


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("lockstep", {}),
        ("switched", {"mode": "nominal", "switch": "robust"}),
        ("real-time", {"real_time": True}),
    ],
)
def test_the_commands_of_a_flight_come_out_again(name, options):
    result = replay(read_recording(recorded(name, **options))).result()

    assert result["samples"] >= (40 if name == "real-time" else 60)
    assert result["samples"] == result["steps"]
    assert result["max_abs_command_difference"] <= EXACT
    assert result["rotor_speeds"] == {"recorded": result["steps"]}
    assert result["notes"] == []


def test_changes_in_flight_are_made_at_their_steps():
    bag = recorded("switched", mode="nominal", switch="robust")
    replayed = replay(read_recording(bag))

    assert [mode for _, mode in replayed.modes] == ["nominal", "robust"]
    assert 0.5 < replayed.modes[1][0] < 1.5
    assert replayed.recording.controller_changes[-1].values == {"weights.yaw": 30.0}
    recorded_margins = replayed.flown.margins
    assert replayed.margins.t == pytest.approx(recorded_margins.t, abs=1e-9)
    assert replayed.margins.alpha_g == pytest.approx(recorded_margins.alpha_g, abs=1e-12)
    assert replayed.margins.by_channel == pytest.approx(recorded_margins.by_channel, abs=1e-12)


def test_the_other_controller_answers_the_same_odometry(gtmr, tmp_path):
    out, html = tmp_path / "replay.json", tmp_path / "replay.html"
    bag = recorded("lockstep")
    run = gtmr("replay", bag, "--mode", "nominal", "--json", out, "--report", html)
    assert run.returncode == 0, run.stderr
    result = json.loads(out.read_text())

    assert (result["mode"], result["samples"]) == ("nominal", result["steps"])
    assert result["max_abs_command_difference"] > 1e-3
    assert result["replayed"]["largest_margin_m"] == 0.0
    assert result["recorded"]["largest_margin_m"] > 0.05
    foreseen = [result[who]["largest_foreseen_residual_m"] for who in ("recorded", "replayed")]
    assert all(-0.3 < residual < 0.0 for residual in foreseen)
    assert foreseen[0] != foreseen[1]
    text = html.read_text(encoding="utf-8")
    assert "nominal, replayed" in text
    assert "robust, foreseen" in text
    assert f"{result['samples']} commands compared" in run.stdout


def test_without_rotor_states_the_commands_tell_the_speeds(tmp_path):
    bag = copied(recorded("lockstep"), tmp_path / "bag", leaving_out("/rotor_states"))
    result = replay(read_recording(bag)).result()

    assert result["rotor_speeds"] == {"from_command": result["samples"]}
    assert result["max_abs_command_difference"] < 1e-6
    assert any("recorded command" in note for note in result["notes"])


def test_an_odometry_that_comes_late_changes_no_step_and_is_told(gtmr, tmp_path):
    def swapped(messages):
        first, second = [k for k, m in enumerate(messages) if m.topic == "/odom"][200:202]
        messages[first], messages[second] = messages[second], messages[first]
        return messages

    out = tmp_path / "replay.json"
    run = gtmr("replay", copied(SAMPLE, tmp_path / "bag", swapped), "--json", out)

    result = json.loads(out.read_text())
    assert result["steps"] == replay(read_recording(SAMPLE)).result()["steps"] == 841
    assert result["max_abs_command_difference"] <= 1e-6
    assert result["late_messages"] == {"odom": 1}
    assert f"1 of {1 + 840 * ODOM_A_STEP} odom messages came late" in " ".join(result["notes"])
    assert "came late" in run.stdout


def test_without_commands_nothing_is_compared_and_the_commands_are_the_same(tmp_path):
    bag = copied(recorded("lockstep"), tmp_path / "bag", leaving_out("/rotor_command"))
    with_commands = replay(read_recording(recorded("lockstep")))
    without = replay(read_recording(bag))

    result = without.result()
    assert (result["samples"], result["max_abs_command_difference"]) == (0, None)
    assert any("no rotor_command" in note for note in result["notes"])
    for ours, theirs in zip(without.steps, with_commands.steps, strict=False):
        assert ours.foreseen == pytest.approx(theirs.foreseen, abs=1e-12)


def test_a_bag_from_elsewhere_is_answered_and_what_is_guessed_is_said(gtmr, foreign, tmp_path):
    out = tmp_path / "replay.json"
    run = gtmr("replay", foreign(), "--json", out)
    assert run.returncode == 0, run.stderr
    result = json.loads(out.read_text())

    assert (result["steps"], result["samples"], result["mode"]) == (40, 0, "robust")
    assert result["rotor_speeds"] == {"estimated": 40}
    assert result["replayed"]["failed_steps"] == 0
    notes = " ".join(result["notes"])
    for said in ("/drone/state", "'world'", "'drone'", "estimated", "rotor_command", "defaults"):
        assert said in notes
        assert said in run.stdout
    # On the reference, at hover: there is little to correct.
    assert result["replayed"]["largest_foreseen_residual_m"] == pytest.approx(-0.15, abs=0.02)


def test_a_damaged_bag_is_replayed_behind_the_damage_and_says_what_it_covers(gtmr, tmp_path):
    bag = damage_chunks(shutil.copytree(SAMPLE, tmp_path / "bag"), 5)

    run = gtmr("replay", bag, "--json", tmp_path / "replay.json")

    assert run.returncode == 0
    assert "warning: bag: covers" in run.stderr
    result = json.loads((tmp_path / "replay.json").read_text())
    coverage = result["coverage"]
    assert coverage["causes"] == {"damaged chunk": 1}
    assert coverage["lost_messages"]["/odom"] > 0
    assert coverage["covered_s"] < coverage["expected_s"] == pytest.approx(21.0)
    assert result["steps"] == 841 - coverage["lost_messages"]["/odom"] // ODOM_A_STEP


def test_a_recording_begun_late_says_which_parameters_it_guessed(gtmr, tmp_path):
    out, html = tmp_path / "replay.json", tmp_path / "replay.html"
    bag = copied(SAMPLE, tmp_path / "bag", leaving_out("/parameter_events"))
    run = gtmr("replay", bag, "--json", out, "--report", html)

    result = json.loads(out.read_text())
    guessed = result["guessed_parameters"]
    assert guessed["mode"] == "robust"
    assert guessed["vehicle"] == Vehicle.paper().name
    assert guessed["tower.min_clearance_m"] == 0.2
    assert set(guessed) >= {"horizon", "weights.yaw", "helix.speed_m_s"}
    for said in (run.stderr, run.stdout, html.read_text(encoding="utf-8")):
        assert "tower.min_clearance_m = 0.2" in said
        assert f"{len(guessed)} parameters of /nmpc are not in the bag" in said
    assert run.stderr.startswith("gtmr: warning:")


def test_only_what_neither_the_bag_nor_an_option_tells_is_guessed(foreign):
    recording = read_recording(foreign())
    octo = Vehicle.preset("vehicle", "octo")

    assert "vehicle" not in RecordedParameters(recording, vehicle=octo).guessed
    assert "horizon" in RecordedParameters(recording, vehicle=octo).guessed
    assert RecordedParameters(recording, config=ControllerConfig()).guessed == {"mode": "robust"}
    assert RecordedParameters(recording, "nominal", ControllerConfig()).guessed == {}
    assert RecordedParameters(read_recording(SAMPLE)).guessed == {}


def test_topics_and_rotors_of_other_names_are_found_by_option(foreign):
    bag = foreign(rotor_period_ns=20_000_000)
    recording = read_recording(bag, odom="/drone/state", rotors="/drone/motors")
    replayed = replay(recording, mode="nominal")

    sources = replayed.result()["rotor_speeds"]
    assert sources["interpolated"] >= 38
    assert set(sources) <= {"interpolated", "estimated"}
    assert any("other names" in note for note in replayed.notes)
    assert [flight.replayed for flight in replayed.flights()] == [False, True]


def test_rotor_speeds_that_are_estimated_hold_the_vehicle_in_its_motion():
    vehicle = Vehicle.paper()
    x = Helix().initial_state(Tower(), vehicle)
    x[3:6], x[VELOCITY], x[RATE] = (0.1, -0.05, 2.0), (0.4, -0.3, 0.1), (0.1, 0.2, 0.3)
    x[ROTORS] = quasi_static_rotor_speeds(x, vehicle)

    change = dynamics(x, np.zeros(6), np.zeros(9), np.zeros(3), vehicle)
    assert change[VELOCITY] == pytest.approx(np.zeros(3), abs=1e-9)
    assert change[RATE] == pytest.approx(np.zeros(3), abs=1e-9)


def test_estimated_speeds_at_hover_are_those_of_hover_for_any_vehicle():
    for name in ("paper", "octo"):
        vehicle = Vehicle.preset("vehicle", name)
        speeds = quasi_static_rotor_speeds(np.zeros(12), vehicle)
        assert speeds == pytest.approx(vehicle.hover_rotor_speeds_hz)


def test_the_problem_is_that_of_the_recorded_parameters(monkeypatch):
    built = []

    class Spy(Controller):
        def __init__(self, config, mode):
            built.append(config)
            super().__init__(config, mode)

    monkeypatch.setattr("gtmr_study.ros.replay.run.Controller", Spy)
    recording = read_recording(recorded("lockstep"))
    recording.controller_changes[0].values.update(
        {"tower.min_clearance_m": 0.21, "weights.yaw": 40.0}
    )
    replay(recording)

    assert (built[0].tower.min_clearance_m, built[0].weights.yaw) == (0.21, 40.0)
    assert built[0].vehicle == Vehicle.paper()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["nowhere"], "nowhere"),
        (["{bag}", "--mode", "bold"], "--mode = 'bold'"),
        (["{bag}", "--odom", "/other"], "/drone/state"),
        (["{bag}", "--rotors", "/other"], "/other"),
        (["{bag}", "--vehicle", "hexa"], "'hexa'"),
        (["{bag}", "--controller", "none.yaml"], "none.yaml"),
        (["{bag}", "--json", "nowhere/r.json"], "nowhere"),
        (["{bag}", "--report", "{kept}"], "not overwritten"),
    ],
)
def test_bad_input_gets_one_clear_line_and_changes_nothing(
    refused, foreign, tmp_path, monkeypatch, arguments, named
):
    monkeypatch.chdir(tmp_path)
    kept = tmp_path / "kept.html"
    kept.write_text("mine")
    bag = foreign(rotor_period_ns=None)
    before = sorted(Path(tmp_path).rglob("*"))

    assert named in refused("replay", *(a.format(bag=bag, kept=kept) for a in arguments))

    assert sorted(Path(tmp_path).rglob("*")) == before
    assert kept.read_text() == "mine"


def test_several_vehicles_are_told_apart_by_their_odometry(tmp_path):
    message = STORE.serialize_cdr(foreign_odometry(0, along_the_helix(0.0)), ODOMETRY)
    with BagWriter(tmp_path / "bag") as bag:
        for name in ("/nominal/odom", "/robust/odom"):
            bag.add_topic(name, ODOMETRY)
            bag.write(name, bytes(message), 1)

    with pytest.raises(BagError, match="--odom: /nominal/odom, /robust/odom"):
        read_recording(tmp_path / "bag")
    assert read_recording(tmp_path / "bag", odom="/robust/odom").node == "/robust/nmpc"
