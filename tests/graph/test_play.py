# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A bag that is played drives the nodes as the flight did."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from itertools import pairwise

import pytest
import yaml

pytest.importorskip("rclpy")

from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from support.launch_stubs import parameters
from support.recorded_flight import recorded
from support.ros_graph import SOURCES, RosGraph

from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.reader import read_messages
from gtmr_monitor.bag.writer import BagWriter
from gtmr_msgs_py import topics
from gtmr_msgs_py.start.environment import ros_environment
from gtmr_msgs_py.wire import stamps
from gtmr_study.ros.play import play, read_playlist

TIMEOUT_S = 60.0


@pytest.fixture
def graph(monkeypatch):
    with RosGraph() as graph:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(graph.domain_id))
        yield graph


@contextmanager
def playing(graph, *arguments):
    """The command line in a process of its own."""
    path = os.pathsep.join(filter(None, [str(SOURCES), os.environ.get("PYTHONPATH")]))
    process = subprocess.Popen(
        [sys.executable, "-m", "gtmr_study.cli", "play", *map(str, arguments)],
        env=ros_environment(graph.domain_id) | {"PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def recorded_stamps(bag, topic):
    messages = [m.decode() for m in read_messages(bag) if m.topic == topic]
    return [stamps.decode(m.clock if topic == "/clock" else m.header.stamp) for m in messages]


def heard_stamps(graph, topic):
    messages = graph.received[topic]
    return [stamps.decode(m.clock if topic == "/clock" else m.header.stamp) for m in messages]


@pytest.fixture
def odometry_alone(tmp_path):
    """The last 9 messages of a flight's odometry, in a bag without a clock."""
    wanted = [m for m in read_messages(recorded("lockstep")) if m.topic == "/odom"][-9:]
    with BagWriter(tmp_path / "odometry") as copy:
        copy.add_topic("/odom", wanted[0].msgtype)
        for message in wanted:
            copy.write(message.topic, message.data, message.log_time_ns)
    return tmp_path / "odometry"


def test_the_nodes_answer_a_playback_as_they_answered_the_flight(graph):
    bag = recorded("lockstep")
    commanded = recorded_stamps(bag, "/rotor_command")
    graph.listen([topics.ROTOR_COMMAND, topics.CLOCK, topics.CLEARANCE])
    graph.start("gtmr_nmpc.node")
    graph.start("gtmr_monitor.node")
    graph.wait_until(lambda: graph.node.count_subscribers("/odom") == 2)
    with playing(graph, bag, "--rate", "0.5") as process:
        graph.wait_until(lambda: process.poll() is not None)
        assert process.returncode == 0
        assert "Playing /clock, /ground_truth, /odom, /rotor_states" in process.stdout.read()
        assert process.stderr.read() == ""

    answered = set(heard_stamps(graph, "rotor_command"))
    assert answered <= set(commanded)
    # The loop takes only the newest odometry: a busy machine leaves some unanswered.
    assert len(answered) >= 0.5 * len(set(commanded))
    assert max(answered) >= commanded[-10]
    assert set(heard_stamps(graph, "/clock")) <= set(recorded_stamps(bag, "/clock"))
    assert set(heard_stamps(graph, "clearance")) <= set(recorded_stamps(bag, "/odom"))
    assert graph.received["clearance"]


def test_played_in_a_loop_it_begins_again_until_ctrl_c(graph, odometry_alone):
    graph.listen([topics.ODOM])
    with playing(graph, odometry_alone, "--loop", "--rate", "2") as process:

        def begins():
            times = heard_stamps(graph, "odom")
            return sum(after < before for before, after in pairwise(times))

        graph.wait_until(lambda: begins() >= 2)
        process.send_signal(signal.SIGINT)
        _, complaints = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0
    assert complaints == ""


def test_the_messages_come_at_the_recorded_intervals_and_with_a_clock(graph, odometry_alone):
    playlist = read_playlist(odometry_alone)
    graph.listen([topics.ODOM, topics.CLOCK])
    told = []
    began = time.monotonic()
    notes = play(playlist, rate=0.5, on_progress=told.append)

    assert time.monotonic() - began >= 2.0 * playlist.duration_s
    log_ns = [m.log_time_ns for m in read_messages(odometry_alone)]
    assert told == pytest.approx([1e-9 * (t - log_ns[0]) for t in log_ns])
    assert notes == []
    graph.wait_until(lambda: heard_stamps(graph, "/clock")[-1:] == log_ns[-1:])
    graph.wait_until(lambda: len(graph.received["odom"]) >= len(log_ns) - 1)
    assert set(heard_stamps(graph, "/clock")) <= set(log_ns)


def test_played_to_nobody_it_says_so(graph, odometry_alone):
    assert play(read_playlist(odometry_alone), rate=10.0, wait_s=0.0) == [
        "nobody listened at the start to /odom"
    ]


def test_what_the_nodes_publish_themselves_is_played_only_on_request():
    bag = recorded("lockstep")
    assert set(read_playlist(bag).types) == {"/odom", "/ground_truth", "/rotor_states", "/clock"}
    assert {"/rotor_command", "/tightening"} < set(read_playlist(bag, everything=True).types)


def test_a_bag_without_a_flight_is_refused_in_one_line(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/chatter", "std_msgs/msg/Float64")
        bag.write("/chatter", bytes(12), 1)
    with pytest.raises(BagError, match=r"holds no topic named odom .* but /chatter; --all"):
        read_playlist(tmp_path / "bag")
    assert read_playlist(tmp_path / "bag", everything=True).types == {
        "/chatter": "std_msgs/msg/Float64"
    }


@pytest.mark.parametrize("option", [["--rate", "0"], ["--rate", "nan"], ["--wait", "-1"]])
def test_an_option_out_of_range_is_refused_in_one_line(refused, option):
    assert refused("play", "bag", *option).startswith(f"gtmr: {option[0]} = ")


def test_rosbag2_would_offer_what_the_nodes_ask_for():
    """`ros2 bag play` offers the recorded quality of service under the recorded names."""
    text = (recorded("lockstep") / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    there = {
        entry["topic_metadata"]["name"]: entry["topic_metadata"]
        for entry in information["topics_with_message_count"]
        if entry["message_count"]
    }
    for topic in (topics.ODOM, topics.ROTOR_STATES, topics.CLOCK):
        told = there["/" + topic.name.lstrip("/")]
        (profile,) = told["offered_qos_profiles"]
        offered = QoSProfile(
            depth=profile["depth"],
            reliability=ReliabilityPolicy[profile["reliability"].upper()],
            durability=DurabilityPolicy[profile["durability"].upper()],
        )
        assert told["type"] == topic.type_name
        assert told["serialization_format"] == "cdr"
        for asked in (topics.NEWEST, topics.OFFERED):
            # Jazzy warns of what is left to the middleware's default.
            assert qos_check_compatible(offered, asked)[0] is not QoSCompatibility.ERROR


def test_the_launch_file_plays_a_bag_to_controller_and_monitor(launch):
    _, (nmpc, monitor, player) = launch(
        "replay", bag="bags/mine", mode="nominal", record="bags/new", rate="2", loop="true"
    )
    assert [nmpc.executable, monitor.executable] == ["nmpc", "monitor"]
    assert parameters(nmpc) == {"mode": "nominal", "use_sim_time": True}
    assert parameters(monitor) == {"bag": "bags/new", "use_sim_time": True}
    assert player.cmd[:5] == ["python3", "-m", "gtmr_study.cli", "play", "bags/mine"]
    assert player.cmd[5:] == ["--rate", "2.0", "--wait", "60", "--loop"]
    # The end of the bag ends the launch.
    assert player.on_exit.__name__ == "required"
    with pytest.raises(ValueError, match="bag:= is missing"):
        launch("replay")
