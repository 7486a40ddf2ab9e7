# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Simulator and controller as processes in a real ROS graph."""

from collections.abc import Iterator

import numpy as np
import pytest
from std_srvs.srv import SetBool, Trigger
from support.loop_messages import odometry_message, rotor_command_message, rotor_states_message
from support.ros_graph import RosGraph

from gtmr_model import Helix, Tower, Vehicle
from gtmr_model.dynamics import ROTORS
from gtmr_msgs_py import topics
from gtmr_msgs_py.messages import odometry, rotor_command, rotor_states, tightening
from gtmr_msgs_py.node import diagnostics
from gtmr_msgs_py.node.parameter_events import PARAMETER_EVENTS
from gtmr_msgs_py.wire import stamps
from gtmr_nmpc import Controller
from gtmr_sim import Scenario, fly

SIM, NMPC = "gtmr_sim.node", "gtmr_nmpc.node"
LOCKSTEP = {"lockstep": "true", "real_time_factor": "0.0"}
LOOP = (
    topics.ODOM,
    topics.ROTOR_STATES,
    topics.ROTOR_COMMAND,
    topics.TIGHTENING,
    topics.SOLVE_TIME,
)
START = Helix().initial_state(Tower(), Vehicle.paper())


@pytest.fixture
def graph() -> Iterator[RosGraph]:
    with RosGraph() as graph:
        yield graph


def states(graph):
    """Stamps [s] and states that were published, in order and without repetitions."""
    speeds = dict(rotor_states.decode(msg, 6) for msg in graph.received["rotor_states"])
    bodies = dict(odometry.decode(msg) for msg in graph.received["odom"])
    both = sorted(speeds.keys() & bodies.keys())
    return [stamps.seconds(t) for t in both], np.array([np.r_[bodies[t], speeds[t]] for t in both])


def same_state(ours, theirs):
    """Compare states whose yaw may differ by whole turns."""
    difference = np.asarray(ours) - theirs
    difference[..., 5] = (difference[..., 5] + np.pi) % (2.0 * np.pi) - np.pi
    return np.abs(difference).max()


def figures(graph, name):
    """The newest diagnostics of a node."""
    for msg in reversed(graph.received["/diagnostics"]):
        if msg.status[0].name.startswith(name):
            return diagnostics.decode(msg.status[0])
    return {}


def publish_state(publishers, time_ns, x):
    publishers[0].publish(odometry_message(time_ns, x))
    publishers[1].publish(rotor_states_message(time_ns, x[ROTORS]))


def test_every_topic_and_service_appears_and_ctrl_c_ends_both_nodes_cleanly(graph):
    published = [t for t in topics.TOPICS if {"sim", "nmpc"} & set(t.publishers)]
    graph.listen(published)
    nodes = [graph.start(SIM), graph.start(NMPC)]
    graph.wait_until(lambda: all(graph.received[topic.name] for topic in published))

    def absolute(name):
        return name.replace("~", "/sim") if name.startswith("~") else "/" + name.lstrip("/")

    def services():
        return dict(graph.node.get_service_names_and_types())

    types = dict(graph.node.get_topic_names_and_types())
    assert all(types[absolute(t.name)] == [t.type_name] for t in published)
    graph.wait_until(lambda: {absolute(s.name) for s in topics.SERVICES} <= services().keys())
    assert all(services()[absolute(s.name)] == [s.type_name] for s in topics.SERVICES)

    assert [node.interrupt() for node in nodes] == [0, 0]
    assert not any("Traceback" in node.output for node in nodes)


@pytest.mark.parametrize("mode", ["nominal", "robust"])
def test_a_flight_in_lockstep_is_the_flight_in_process(graph, mode):
    # The flight waits for who listens to the loop; who is found there is found here too.
    listened = (topics.CLOCK, *LOOP)
    graph.listen(listened)
    graph.start(NMPC, mode=mode, recorders="1")
    flight = {"duration_s": "2.0", "seed": "7", "sample_zeta": "true", "recorders": "1"}
    assert graph.start(SIM, **LOCKSTEP, **flight).wait() == 0
    graph.wait_until(lambda: len(states(graph)[0]) == 81)
    graph.wait_until(lambda: all(len(graph.received[topic.name]) >= 81 for topic in listened))

    log = fly(Scenario(seed=7).sampled(), Controller(mode=mode), 2.0)
    times, x = states(graph)
    assert times == pytest.approx(np.append(log.t, 2.0))
    assert same_state(x[:-1], log.x) < 1e-9
    ticks = {stamps.decode(msg.clock) for msg in graph.received["/clock"]}
    assert ticks == {stamps.nanoseconds(t) for t in times}
    plans = {
        plan.stamp_ns: plan
        for plan in (rotor_command.decode(msg, 6) for msg in graph.received["rotor_command"])
    }
    u = np.array([plans[stamps.nanoseconds(t)].u[0] for t in log.t])
    assert u == pytest.approx(log.u, abs=1e-6)
    margins = [tightening.decode(msg) for msg in graph.received["tightening"]][:80]
    assert np.array([m.alpha_p for m in margins]) == pytest.approx(log.alpha_p, abs=1e-9)
    assert np.array([m.alpha_g for m in margins]) == pytest.approx(log.alpha_g, abs=1e-9)


def test_the_mode_switches_in_flight_and_a_bad_one_is_refused(graph):
    graph.listen([topics.TIGHTENING, topics.ODOM])
    # In lockstep, since a controller that is held up for long cannot keep clear.
    graph.start(SIM, lockstep="true")
    graph.start(NMPC, mode="robust")

    def tightened():
        return [tightening.decode(msg).alpha_p.max() > 0.0 for msg in graph.received["tightening"]]

    graph.wait_until(lambda: len(tightened()) > 5)
    assert all(tightened())
    assert graph.set_parameter("nmpc", "mode", "nominal").successful
    graph.wait_until(lambda: tightened()[-5:] == [False] * 5)

    refused = graph.set_parameter("nmpc", "mode", "bold")
    assert not refused.successful
    assert "'nominal', 'robust' or 'offset_free'" in refused.reason
    assert graph.get_parameter("nmpc", "mode") == "nominal"
    assert not graph.set_parameter("nmpc", "horizon", 10).successful

    assert graph.set_parameter("nmpc", "mode", "robust").successful
    graph.wait_until(lambda: tightened()[-5:] == [True] * 5)
    flown = np.array([odometry.decode(msg)[1] for msg in graph.received["odom"]])
    assert np.all(Tower().residual(flown) < 0.0)


def test_pause_stops_time_and_reset_repeats_the_flight(graph):
    graph.listen([topics.ODOM, topics.ROTOR_STATES, topics.DIAGNOSTICS])
    graph.start(NMPC)
    graph.start(SIM, seed="3", recorders="1", **LOCKSTEP)
    # A state that is not answered soon comes again.
    graph.wait_until(lambda: len(states(graph)[0]) > 40)
    assert graph.call(SetBool, "sim/pause", SetBool.Request(data=True)).success

    def paused_at():
        status = [msg.status[0] for msg in graph.received["/diagnostics"]]
        return [diagnostics.decode(s)["time_s"] for s in status if s.message == "paused"]

    graph.wait_until(lambda: len(paused_at()) >= 2)
    assert paused_at()[0] == paused_at()[1] > 0.5
    graph.wait_until(lambda: states(graph)[0][-1] >= paused_at()[1])
    times, first = states(graph)
    assert times[-1] == paused_at()[1]

    graph.received["odom"].clear()
    graph.received["rotor_states"].clear()
    assert graph.call(Trigger, "sim/reset", Trigger.Request()).success
    assert graph.call(SetBool, "sim/pause", SetBool.Request(data=False)).success
    graph.wait_until(lambda: len(states(graph)[0]) > 41)
    times_again, again = states(graph)
    assert times_again[:40] == times[:40]
    assert same_state(first[:40], again[:40]) < 1e-9


def test_a_simulator_that_is_paused_before_its_flight_says_so_and_flies_when_told_to(graph):
    graph.listen([topics.DIAGNOSTICS, topics.ODOM])

    def last():
        return graph.received["/diagnostics"][-1].status[0].message

    sim = graph.start(SIM)
    graph.wait_until(lambda: graph.received["/diagnostics"] and last().startswith("waiting for"))
    assert graph.call(SetBool, "sim/pause", SetBool.Request(data=True)).success
    graph.wait_until(lambda: last() == "paused")
    assert graph.call(SetBool, "sim/pause", SetBool.Request(data=False)).success
    graph.wait_until(lambda: last().startswith("waiting for"))
    graph.received["/diagnostics"].clear()
    graph.start(NMPC)
    graph.wait_until(lambda: "flying" in sim.output)


def test_the_flight_starts_only_once_a_controller_answers(graph):
    graph.listen([topics.ODOM, topics.ROTOR_STATES])
    graph.start(SIM)
    graph.wait_until(lambda: len(graph.received["odom"]) >= 3)
    assert {odometry.decode(msg)[0] for msg in graph.received["odom"]} == {0}
    graph.start(NMPC)
    graph.wait_until(lambda: odometry.decode(graph.received["odom"][-1])[0] > 10**8)


def test_who_keeps_a_flight_from_starting_is_named(graph):
    graph.listen([topics.DIAGNOSTICS])

    def told(node, message):
        statuses = [msg.status[0] for msg in graph.received["/diagnostics"]]
        return any(s.name.startswith(node) and s.message == message for s in statuses)

    sim = graph.start(SIM, recorders="1")
    graph.wait_until(lambda: told("sim", "waiting for a controller and a recorder"))
    assert "waits for a controller and a recorder" in sim.output
    graph.start(NMPC, recorders="1")
    graph.wait_until(lambda: told("sim", "waiting for a recorder"))
    graph.wait_until(lambda: told("nmpc", "waiting for a recorder"))


def test_another_clock_beside_that_of_the_simulator_is_told(graph):
    graph.listen([topics.DIAGNOSTICS])
    topics.CLOCK.publisher(graph.node)
    sim = graph.start(SIM)
    statuses = graph.received["/diagnostics"]
    graph.wait_until(lambda: any("/clock has several" in m.status[0].message for m in statuses))
    assert "/clock has several publishers" in sim.output


def test_all_parameters_are_told_again_when_a_flight_begins(graph):
    # Both nodes know of the first listener before they know of the others, which then hear them.
    graph.listen([PARAMETER_EVENTS, topics.ODOM, topics.ROTOR_COMMAND])
    graph.start(NMPC)
    graph.start(SIM)

    def told(node, name):
        events = [m for m in graph.received[PARAMETER_EVENTS.name] if m.node == node]
        return any(name in [p.name for p in event.new_parameters] for event in events)

    # What is reset before the controller saw it move on from time zero is the same flight to it.
    graph.wait_until(lambda: all(graph.received[name] for name in ("odom", "rotor_command")))
    commands = graph.received["rotor_command"]
    graph.wait_until(lambda: rotor_command.decode(commands[-1], 6).stamp_ns > 100_000_000)
    graph.received[PARAMETER_EVENTS.name].clear()
    assert graph.call(Trigger, "sim/reset", Trigger.Request()).success
    graph.wait_until(lambda: told("/nmpc", "weights.position"))
    graph.wait_until(lambda: told("/sim", "zeta"))


def test_the_simulator_plays_the_rest_of_the_plan_when_commands_go_missing(graph):
    graph.listen([topics.ODOM, topics.ROTOR_STATES, topics.DIAGNOSTICS])
    command = topics.ROTOR_COMMAND.publisher(graph.node)
    graph.start(SIM, gust__kind="none", guard="hold")
    graph.wait_until(lambda: bool(graph.received["odom"]))
    u = np.zeros((20, 6))
    u[10:] = 40.0
    plan = rotor_command_message(0, 25_000_000, np.tile(START[ROTORS], (21, 1)), u)

    def flies():
        # The first ones may be lost while the nodes match.
        command.publish(plan)
        return odometry.decode(graph.received["odom"][-1])[0] > 0

    graph.wait_until(flies)
    graph.wait_until(lambda: figures(graph, "sim").get("missed_commands", 0) > 0)
    graph.wait_until(lambda: states(graph)[0][-1] > 0.6)
    times, x = states(graph)
    speeds = dict(zip(np.round(times, 6), x[:, 12], strict=True))
    assert speeds[0.25] == pytest.approx(START[12])
    assert speeds[0.5] == pytest.approx(START[12] + 10.0)
    assert speeds[0.6] == pytest.approx(START[12] + 10.0)


def test_odometry_that_cannot_be_used_is_passed_over(graph):
    graph.listen([topics.ROTOR_COMMAND, topics.DIAGNOSTICS])
    publishers = [topic.publisher(graph.node) for topic in (topics.ODOM, topics.ROTOR_STATES)]
    node = graph.start(NMPC)
    not_finite = np.where(np.arange(18) == 1, np.nan, START)

    def publish_until(x, condition):
        # The first messages may be lost while the nodes match.
        def condition_after_publishing():
            publish_state(publishers, 25_000_000, x)
            return condition()

        graph.wait_until(condition_after_publishing)

    publish_until(not_finite, lambda: figures(graph, "nmpc").get("dropped_undecodable", 0) > 0)
    assert not graph.received["rotor_command"]
    publish_until(START, lambda: bool(graph.received["rotor_command"]))
    assert "not finite" in node.output
    assert "Traceback" not in node.output


def test_a_repeated_odometry_gets_the_same_command_and_an_early_one_none(graph):
    graph.listen([topics.ROTOR_COMMAND, topics.SOLVE_TIME])
    publishers = [topic.publisher(graph.node) for topic in (topics.ODOM, topics.ROTOR_STATES)]
    graph.start(NMPC)
    graph.wait_until(lambda: all(p.get_subscription_count() for p in publishers))
    received = graph.received["rotor_command"]

    def answer_to(time_ns):
        def answered():
            publish_state(publishers, time_ns, START)
            return received[-1:] and rotor_command.decode(received[-1], 6).stamp_ns == time_ns

        graph.wait_until(answered)
        count = len(received)
        publish_state(publishers, time_ns, START)
        graph.wait_until(lambda: len(received) > count)
        return [rotor_command.decode(msg, 6) for msg in received]

    first = answer_to(10**9)
    assert {plan.stamp_ns for plan in first} == {10**9}
    assert all(np.array_equal(plan.u, first[0].u) for plan in first)
    publish_state(publishers, 10**9 + 5_000_000, START)
    later = answer_to(10**9 + 25_000_000)
    assert {plan.stamp_ns for plan in later} == {10**9, 10**9 + 25_000_000}


def test_a_late_odometry_is_counted_and_the_controller_goes_on_as_if_it_had_not_come(graph):
    graph.listen([topics.ROTOR_COMMAND, topics.DIAGNOSTICS])
    publishers = [topic.publisher(graph.node) for topic in (topics.ODOM, topics.ROTOR_STATES)]
    graph.start(NMPC)
    graph.wait_until(lambda: all(p.get_subscription_count() for p in publishers))

    def answered(k):
        def published_and_answered():
            publish_state(publishers, 10**10 + k * 25_000_000, START)
            plans = [rotor_command.decode(m, 6) for m in graph.received["rotor_command"]]
            return any(plan.stamp_ns == 10**10 + k * 25_000_000 for plan in plans)

        graph.wait_until(published_and_answered)

    for k in range(4):
        answered(k)
    publish_state(publishers, 10**10 + 3 * 25_000_000 - 1, START)
    graph.wait_until(lambda: figures(graph, "nmpc").get("dropped_late") == 2)
    answered(4)
    times = [rotor_command.decode(m, 6).stamp_ns for m in graph.received["rotor_command"]]
    assert times == sorted(times)
    assert set(times) == {10**10 + k * 25_000_000 for k in range(5)}


@pytest.mark.parametrize(
    ("module", "parameters", "reason"),
    [
        (SIM, {"vehicle": "nope"}, "there is"),
        (NMPC, {"mode": "bold"}, "'nominal', 'robust' or 'offset_free'"),
        (SIM, {"seed": "0.5"}, "expected integer"),
        (NMPC, {"tower.radius_m": "-1.0"}, "out of range"),
        (NMPC, {"horizonn": "30"}, "no parameter horizonn: the closest is horizon"),
    ],
)
def test_a_bad_parameter_ends_the_node_with_one_clear_line(graph, module, parameters, reason):
    node = graph.start(module, **parameters)
    assert node.wait() == 2
    (line,) = node.output.strip().splitlines()
    assert line.startswith("error: ")
    assert reason in line
