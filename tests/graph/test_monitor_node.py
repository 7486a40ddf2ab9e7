# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The monitor as a process in a real ROS graph."""

import math
import signal
import subprocess
import sys
import time
import warnings
from contextlib import contextmanager

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from support.loop_messages import odometry_message  # noqa: E402
from support.ros_graph import claim_domain  # noqa: E402

from gtmr_model import Tower  # noqa: E402
from gtmr_monitor.bag.flight import read_flight  # noqa: E402
from gtmr_monitor.bag.reader import TruncatedBagWarning, read_messages  # noqa: E402
from gtmr_msgs_py import topics  # noqa: E402
from gtmr_msgs_py.node import diagnostics  # noqa: E402
from gtmr_msgs_py.start.environment import ros_environment  # noqa: E402

DOMAIN_ID, CLAIM = claim_domain()
TIMEOUT_S = 60.0
TOWER = Tower()
# What it tells of itself once a second is waited for by most tests.
MONITOR = """
import sys
from gtmr_monitor import node
node.DIAGNOSTICS_PERIOD_S = 0.1
sys.exit(node.main())
"""
ZETA = [0.1, 0.0, -0.05, 0.0, 0.0, 0.2, 0.6, 0.4, 0.0]


class Graph:
    """A vehicle, in the sim's place, and whoever listens to the monitor."""

    def __init__(self, namespace=""):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN_ID)
        self.node = Node("sim", context=self.context, namespace=namespace)
        self.node.declare_parameter("seed", 7)
        self.node.declare_parameter("zeta", ZETA)
        self.node.declare_parameter("gust.kind", "ou")
        self.node.declare_parameter("tower.radius_m", TOWER.radius_m)
        self.odometry = topics.ODOM.publisher(self.node)
        self.clock = topics.CLOCK.publisher(self.node)
        self.residuals, self.heard_s, self.statuses = [], [], []
        topics.CLEARANCE_RESIDUAL.subscription(self.node, self._hear)
        topics.DIAGNOSTICS.subscription(
            self.node, lambda message: self.statuses.append(message.status[0])
        )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def _hear(self, message):
        self.residuals.append(message.data)
        self.heard_s.append(time.monotonic())

    def wait_until(self, condition):
        deadline = time.monotonic() + TIMEOUT_S
        while not condition():
            assert time.monotonic() < deadline, "timed out"
            self.executor.spin_once(timeout_sec=0.05)

    def await_monitor(self):
        self.wait_until(
            lambda: (
                self.odometry.get_subscription_count() >= 1
                and self.node.count_publishers(self.residual_topic) >= 1
                and any(status.name.endswith("monitor: clearance") for status in self.statuses)
            )
        )

    @property
    def residual_topic(self):
        return self.node.resolve_topic_name(topics.CLEARANCE_RESIDUAL.name)

    def publish(self, k, position=None, earlier_ns=0):
        x = np.zeros(12)
        angle = 0.05 * k
        radius = 1.2 + 0.1 * math.sin(0.3 * k)
        x[:3] = radius * math.cos(angle), radius * math.sin(angle), 2.0 + 0.01 * k
        if position is not None:
            x[:3] = position
        x[5] = angle + math.pi
        message = odometry_message(k * 25_000_000 - earlier_ns, x)
        self.odometry.publish(message)

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture(autouse=True)
def fast_discovery(monkeypatch):
    for name, value in ros_environment(DOMAIN_ID).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("ROS_PYTHON_CHECK_FIELDS", "1")


@pytest.fixture
def graph():
    graph = Graph()
    yield graph
    graph.close()


@contextmanager
def monitor(*parameters, namespace=""):
    remap = ["-r", f"__ns:={namespace}"] if namespace else []
    process = subprocess.Popen(
        [sys.executable, "-c", MONITOR, "--ros-args", *remap]
        + [argument for parameter in parameters for argument in ("-p", parameter)],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def figures(graph):
    """What the monitor has told of itself so far."""
    return [
        diagnostics.decode(status)
        for status in graph.statuses
        if status.name == "monitor: clearance"
    ]


def seeds_in(bag, node):
    """Seeds of a node that a bag tells of while it is being written."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TruncatedBagWarning)
        events = [m.decode() for m in read_messages(bag) if m.topic == "/parameter_events"]
    told = [(*e.new_parameters, *e.changed_parameters) for e in events if e.node == node]
    return [p.value.integer_value for parameters in told for p in parameters if p.name == "seed"]


def stop(process, how=signal.SIGINT):
    process.send_signal(how)
    _, errors = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
    return errors


def test_the_recorded_residual_is_that_of_the_recorded_odometry(graph, tmp_path):
    bag = tmp_path / "bag"
    with monitor(f"bag:={bag}") as process:
        graph.await_monitor()
        for k in range(80):
            graph.publish(k)
        graph.wait_until(lambda: len(graph.residuals) == 80)
        stop(process)

    with AnyReader([bag]) as reader:
        recorded = {topic: [] for topic in reader.topics}
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            recorded[connection.topic].append(message)
    poses = [m.pose.pose.position for m in recorded["/odom"]]
    expected = [0.2 - (math.hypot(p.x, p.y) - 1.0) for p in poses]
    assert [m.data for m in recorded["/clearance_residual"]] == pytest.approx(expected, abs=1e-12)
    assert graph.residuals == [m.data for m in recorded["/clearance_residual"]]
    assert [m.range for m in recorded["/clearance"]] == pytest.approx(
        [0.2 - s for s in expected], abs=1e-6
    )
    assert all(m.min_range < m.range < m.max_range for m in recorded["/clearance"])
    stamps = [(m.header.stamp.sec, m.header.stamp.nanosec) for m in recorded["/odom"]]
    assert stamps == [(m.header.stamp.sec, m.header.stamp.nanosec) for m in recorded["/clearance"]]


def test_reads_back_as_a_flight_with_the_parameters_of_all_nodes(graph, tmp_path):
    bag = tmp_path / "bag"
    with monitor(f"bag:={bag}", "tower.min_clearance_m:=0.25") as process:
        graph.await_monitor()
        for k in range(30):
            graph.publish(k)
        graph.wait_until(lambda: len(graph.residuals) == 30)
        graph.wait_until(lambda: 7 in seeds_in(bag, "/sim"))
        graph.node.set_parameters([Parameter("seed", value=8)])
        graph.wait_until(lambda: 8 in seeds_in(bag, "/sim"))
        stop(process, signal.SIGTERM)

    flight = read_flight(bag)

    assert flight.t == pytest.approx(0.025 * np.arange(30))
    assert flight.tower == Tower(min_clearance_m=0.25)
    assert flight.recorded_residual == pytest.approx(flight.residual, abs=1e-12)
    assert flight.heading_error == pytest.approx(np.zeros(30), abs=1e-9)
    assert flight.zeta == pytest.approx(ZETA)
    assert (flight.gust, flight.seed) == ("ou", 8)
    assert flight.parameters["/monitor"]["bag"] == str(bag)
    assert not flight.truncated


def test_in_a_namespace_it_watches_the_vehicle_of_that_namespace(tmp_path):
    graph = Graph("/hex1")
    bag = tmp_path / "bag"
    try:
        with monitor(f"bag:={bag}", namespace="/hex1") as process:
            graph.await_monitor()
            graph.publish(0)
            graph.wait_until(lambda: len(graph.residuals) == 1)
            graph.wait_until(lambda: 7 in seeds_in(bag, "/hex1/sim"))
            stop(process)
    finally:
        graph.close()

    flight = read_flight(bag)
    assert flight.p.shape == (1, 3)
    assert flight.seed == 7


def test_killed_it_leaves_a_bag_that_lacks_less_than_a_second(graph, tmp_path):
    bag = tmp_path / "bag"
    with monitor(f"bag:={bag}") as process:
        graph.await_monitor()
        graph.wait_until(lambda: 7 in seeds_in(bag, "/sim"))
        sent = 60
        start = time.monotonic()
        for k in range(sent):
            due = start + k / 40.0
            graph.wait_until(lambda due=due: time.monotonic() >= due)
            graph.publish(k)
        graph.wait_until(lambda: len(graph.residuals) == sent)
        process.kill()
        process.wait(TIMEOUT_S)

    with pytest.warns(TruncatedBagWarning):
        flight = read_flight(bag)

    assert flight.truncated
    assert flight.t == pytest.approx(0.025 * np.arange(flight.t.size))
    # By the monitor's own answers: a busy machine may hold both of us up.
    assert all(graph.heard_s[-1] - heard_s < 1.0 for heard_s in graph.heard_s[flight.t.size :])
    assert flight.seed == 7


def test_a_pose_that_is_no_number_is_told_and_does_not_stop_it(graph):
    with monitor() as process:
        graph.await_monitor()
        broken = odometry_message(0, np.zeros(12))
        broken.pose.pose.position.x = math.nan
        graph.odometry.publish(broken)
        graph.publish(1)
        graph.wait_until(lambda: any(f["samples"] for f in figures(graph)))
        graph.wait_until(lambda: bool(graph.residuals))
        graph.wait_until(lambda: any(f["dropped_undecodable"] for f in figures(graph)))
        assert len(graph.residuals) == 1
        assert "nan" in stop(process)


def test_a_violation_shows_in_the_diagnostics(graph):
    with monitor() as process:
        graph.await_monitor()
        for k, distance in enumerate((1.3, 1.15, 1.3)):
            graph.publish(k, position=(distance, 0.0, 2.0))
        graph.wait_until(lambda: any(f["samples"] == 3 for f in figures(graph)))
        stop(process)

    last = figures(graph)[-1]
    assert (last["violations"], last["recording"]) == (1, False)
    assert last["worst_residual_m"] == pytest.approx(0.05)
    assert last["residual_m"] == pytest.approx(-0.1)


def test_time_that_goes_back_begins_another_flight(graph):
    with monitor() as process:
        graph.await_monitor()
        graph.publish(40, position=(1.15, 0.0, 2.0))
        graph.wait_until(lambda: any(f["violations"] == 1 for f in figures(graph)))
        for k in range(5):
            graph.publish(k, position=(1.3, 0.0, 2.0))
        graph.wait_until(lambda: figures(graph)[-1]["samples"] == 3)
        stop(process)

    assert figures(graph)[-1]["violations"] == 0


@pytest.mark.parametrize("earlier_ns", [1, 20_000_000])
def test_a_late_odometry_does_not_make_it_forget_a_violation(graph, earlier_ns):
    with monitor() as process:
        graph.await_monitor()
        graph.publish(10, position=(1.15, 0.0, 2.0))
        graph.publish(11, position=(1.4, 0.0, 2.0))
        graph.publish(11, position=(1.3, 0.0, 2.0), earlier_ns=earlier_ns)
        graph.wait_until(lambda: any(f["samples"] == 3 for f in figures(graph)))
        stop(process)

    last = figures(graph)[-1]
    assert (last["violations"], last["late_odometry"]) == (1, 1)
    assert last["worst_residual_m"] == pytest.approx(0.05)
    assert last["residual_m"] == pytest.approx(-0.2)


def test_a_gap_in_the_odometry_is_told(graph):
    with monitor() as process:
        graph.await_monitor()
        for k in (*range(20), *range(30, 40)):
            graph.publish(k)
        graph.wait_until(lambda: any(f["samples"] == 30 for f in figures(graph)))
        assert "gaps so far: 1, 0.28 s in all" in stop(process)

    last = figures(graph)[-1]
    assert (last["odometry_gaps"], last["messages_not_heard"]) == (1, 0)
    assert last["odometry_missing_s"] == pytest.approx(0.275)


def test_a_monitor_that_is_held_up_misses_nothing(graph, tmp_path):
    bag = tmp_path / "bag"
    with monitor(f"bag:={bag}") as process:
        graph.await_monitor()
        graph.publish(0)
        graph.wait_until(lambda: len(graph.residuals) == 1)
        process.send_signal(signal.SIGSTOP)
        for k in range(1, 800):
            graph.publish(k)
        process.send_signal(signal.SIGCONT)
        graph.wait_until(lambda: len(graph.residuals) == 800)
        graph.wait_until(lambda: figures(graph)[-1]["samples"] == 800)
        stop(process)

    assert figures(graph)[-1]["messages_not_heard"] == 0
    coverage = read_flight(bag).coverage
    assert (coverage.whole, coverage.covered_s) == (True, pytest.approx(799 * 0.025))


def test_started_again_it_goes_on_in_the_same_bag_and_says_so(graph, tmp_path):
    bag = tmp_path / "bag"
    with monitor(f"bag:={bag}") as process:
        graph.await_monitor()
        for k in range(20):
            graph.publish(k, position=(1.15, 0.0, 2.0))
        graph.wait_until(lambda: len(graph.residuals) == 20)
        stop(process)
    # What the first one told may still come; it violated, and so says something else.
    said = "clear of the tower since this monitor was started; what was before is in the bag"

    def told():
        return any(s.level == b"\x01" and s.message.startswith(said) for s in graph.statuses)

    with monitor(f"bag:={bag}") as process:
        graph.await_monitor()
        for k in range(30, 50):
            graph.publish(k, position=(1.3, 0.0, 2.0))
        graph.wait_until(told)
        graph.wait_until(lambda: len(graph.residuals) == 40)
        stop(process)

    flight = read_flight(bag)
    assert flight.residual_statistics["samples"] == 40
    assert flight.residual_statistics["violated"]
    assert [p.name for p in sorted(bag.iterdir())] == ["bag_0.mcap", "bag_1.mcap", "metadata.yaml"]


def test_another_tower_than_that_of_the_vehicle_is_told(graph):
    def told(words):
        return any(s.level == b"\x01" and words in s.message for s in graph.statuses)

    with monitor("tower.radius_m:=1.2") as process:
        graph.await_monitor()
        graph.publish(0, position=(1.6, 0.0, 2.0))
        graph.wait_until(lambda: told("tower.radius_m is 1.2 m in monitor, 1 m in sim"))
        graph.node.set_parameters([Parameter("tower.radius_m", value=1.1)])
        graph.wait_until(lambda: told("tower.radius_m is 1.2 m in monitor, 1.1 m in sim"))
        graph.node.set_parameters([Parameter("tower.radius_m", value=1.2)])
        graph.wait_until(lambda: graph.statuses[-1].message == "clear of the tower")
        assert "the nodes differ: tower.radius_m is 1.2 m in monitor, 1 m in sim" in stop(process)


def test_an_estimator_that_publishes_best_effort_is_heard_and_recorded(graph, tmp_path):
    bag = tmp_path / "bag"
    offered = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    graph.node.destroy_publisher(graph.odometry)
    with monitor(f"bag:={bag}") as process:
        graph.odometry = graph.node.create_publisher(Odometry, "odom", offered)
        graph.await_monitor()
        for k in range(5):
            graph.publish(k)
        graph.wait_until(lambda: len(graph.residuals) == 5)
        assert "best effort" in stop(process)

    assert len(read_flight(bag).t) == 5


def test_several_vehicles_go_into_one_bag(graph, tmp_path):
    bag = tmp_path / "bag"
    hex1 = Graph("/hex1")
    try:
        with monitor(f"bag:={bag}", "namespaces:=['', hex1]") as process:
            graph.await_monitor()
            hex1.await_monitor()
            graph.publish(0, position=(1.4, 0.0, 2.0))
            hex1.publish(1, position=(1.5, 0.0, 2.0))
            graph.wait_until(lambda: len(graph.residuals) == 1)
            hex1.wait_until(lambda: len(hex1.residuals) == 1)
            stop(process)
    finally:
        hex1.close()

    assert graph.residuals == pytest.approx([-0.2])
    assert read_flight(bag, "/hex1").recorded_residual == pytest.approx([-0.3])
    assert read_flight(bag, "").recorded_residual == pytest.approx([-0.2])


@pytest.mark.parametrize("parameter", ["bag:={folder}", "tower.radius_m:=-1.0"])
def test_a_parameter_that_cannot_be_used_is_told_in_one_line(tmp_path, parameter):
    (tmp_path / "notes.txt").write_text("mine")
    with monitor(parameter.format(folder=tmp_path)) as process:
        _, errors = process.communicate(timeout=TIMEOUT_S)

    assert process.returncode == 2
    assert len(errors.strip().splitlines()) == 1
    assert parameter.partition(":=")[0] in errors
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
