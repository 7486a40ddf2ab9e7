# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Whole flights in a graph of three processes: switched, sped up, slowed down, side by side."""

import time
from collections.abc import Iterator

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition as TransitionMessage
from lifecycle_msgs.srv import ChangeState
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger
from support.ros_graph import RosGraph

from gtmr_model import Tower
from gtmr_msgs_py import topics
from gtmr_msgs_py.messages import odometry, rotor_command, tightening
from gtmr_msgs_py.node import diagnostics
from gtmr_msgs_py.wire import stamps
from gtmr_nmpc import Controller
from gtmr_sim import Scenario, fly

SIM, NMPC, MONITOR = "gtmr_sim.node", "gtmr_nmpc.node", "gtmr_monitor.node"
LOCKSTEP = {"lockstep": "true", "real_time_factor": "0.0"}
LOOP = (
    topics.ODOM,
    topics.ROTOR_STATES,
    topics.ROTOR_COMMAND,
    topics.TIGHTENING,
    topics.SOLVE_TIME,
)
EPS_S_M = 1e-3
SWITCHES = 50
SWITCH_PERIOD_S = 1.2


@pytest.fixture
def graph() -> Iterator[RosGraph]:
    with RosGraph() as graph:
        yield graph


def times_s(graph, topic, first):
    """Stamps [s] of what was received on a topic, from some message on."""
    return [stamps.decode(m.header.stamp) * 1e-9 for m in graph.received[topic][first:]]


def flown_s(graph, topic="odom"):
    return (times_s(graph, topic, -1) or [0.0])[-1]


def positions(messages):
    """Positions [m] by stamp [ns]."""
    return {stamp_ns: x[:3] for stamp_ns, x in map(odometry.decode, messages)}


def same_flight(messages, log):
    """Whether odometry is that of a flight in process."""
    flown = positions(messages)
    both = [k for k, t in enumerate(log.t) if stamps.nanoseconds(t) in flown]
    ours = np.array([flown[stamps.nanoseconds(log.t[k])] for k in both])
    return len(both) > 0.8 * len(log.t) and np.abs(ours - log.x[both, :3]).max() < 1e-9


def test_a_newcomer_finds_the_graph_within_two_seconds(graph):
    for node in (SIM, NMPC, MONITOR):
        graph.start(node)
    graph.wait_until(lambda: {"sim", "nmpc", "monitor"} <= set(graph.node.get_node_names()))
    took_s = [graph.newcomer_finds("sim", "nmpc", "monitor") for _ in range(3)]
    assert np.median(took_s) < 2.0, took_s


def test_fifty_switches_in_a_minute_make_no_bump_and_no_violation(graph):
    # As bytes: this process has to keep up, to switch when it is time, and so does less at every
    # step than the nodes that the flight waits for.
    graph.listen(LOOP, raw=True)
    received = graph.received
    graph.start(NMPC, mode="nominal", recorders="1")
    graph.start(MONITOR)
    client = graph.parameters_of("nmpc")
    graph.start(SIM, recorders="1", seed="4", lockstep="true", real_time_factor="4.0")

    def flown_s():
        return odometry.unpack(received["odom"][-1])[0] * 1e-9 if received["odom"] else 0.0

    def eps_s_m(margins):
        return tightening.decode(deserialize_message(margins, topics.TIGHTENING.message)).eps_s[0]

    def margins_are(mode):
        now_m = eps_s_m(received["tightening"][-1]) if received["tightening"] else np.nan
        return now_m == pytest.approx(EPS_S_M if mode == "robust" else 0.0)

    mode, switched_s = "nominal", []
    while len(switched_s) < SWITCHES:
        due_s = (switched_s[-1] if switched_s else 0.0) + SWITCH_PERIOD_S
        graph.wait_until(lambda due_s=due_s: flown_s() >= due_s)
        graph.wait_until(lambda mode=mode: margins_are(mode))
        mode = "robust" if mode == "nominal" else "nominal"
        assert graph.set_parameter("nmpc", "mode", mode, client).successful
        switched_s.append(flown_s())
    end_s = max(60.0, switched_s[-1] + SWITCH_PERIOD_S)
    graph.wait_until(lambda: flown_s() > end_s)

    # A command may come twice, for an odometry that came twice; margins come once a step.
    reader = rotor_command.Reader(6)
    by_stamp = {c.stamp_ns: c for c in map(reader.unpack, received["rotor_command"])}
    commands = sorted(by_stamp.values(), key=lambda c: c.stamp_ns)
    n = min(len(commands), len(received["tightening"]))
    assert n > 2300
    # The constant term of the margins tells how far these have come in.
    scale = np.array([eps_s_m(m) for m in received["tightening"][:n]]) / EPS_S_M
    change = np.sign(np.round(np.diff(scale, prepend=0.0), 12))
    direction = [0.0]
    for sign in change:
        direction.append(sign or direction[-1])
    switches = np.flatnonzero(np.diff(direction))
    assert len(switches) == SWITCHES

    u = np.array([c.u[0] for c in commands[:n]])
    jump = np.abs(np.diff(u, axis=0, prepend=u[:1])).max(axis=1)
    ordinary = np.delete(jump, switches)
    assert jump[switches].max() <= ordinary.max()
    assert jump[switches].max() < 5.0

    flown = {stamp_ns: x[:3] for stamp_ns, x in map(odometry.unpack, received["odom"])}
    guarded = [c.stamp_ns for c, s in zip(commands, scale, strict=False) if s > 0.0]
    at = np.array([flown[t] for t in guarded if t in flown])
    assert len(at) > 0.9 * len(guarded)
    assert Tower().residual(at).max() < 0.0


def test_flights_in_namespaces_and_with_other_names_do_not_meet(graph):
    own_clock = {"/clock": "clock"}
    names = {
        "a": {"__ns": "/a", **own_clock},
        "b": {"__ns": "/fleet/b", **own_clock},
        "c": {
            "odom": "state",
            "rotor_states": "rotors",
            "rotor_command": "command",
            "/clock": "time",
        },
    }
    heard = {"a": "/a/odom", "b": "/fleet/b/odom", "c": "state"}
    for seed, (name, remaps) in enumerate(names.items(), start=1):
        topic = heard[name]
        graph.node.create_subscription(
            topics.ODOM.message, topic, graph.received[topic].append, topics.OFFERED
        )
        zeta = {"sample_zeta": "true", "seed": str(seed)}
        graph.start(NMPC, remaps)
        graph.start(SIM, remaps, **zeta, **LOCKSTEP)
    graph.wait_until(lambda: all(flown_s(graph, topic) > 1.0 for topic in heard.values()))
    for seed, topic in enumerate(heard.values(), start=1):
        log = fly(Scenario(seed=seed).sampled(), Controller(), 1.0)
        assert same_flight(graph.received[topic], log), topic


def test_the_pace_changes_in_flight_and_the_flight_stays_the_same(graph):
    graph.listen([topics.ODOM, topics.DIAGNOSTICS])
    graph.start(NMPC, use_sim_time="true")
    graph.start(SIM, lockstep="true", real_time_factor="0.1")
    client = graph.parameters_of("sim")

    graph.wait_until(lambda: flown_s(graph) > 0.0)
    # At the slow pace little is on its way: what is heard late would pass for haste.
    since, wall = flown_s(graph), time.monotonic()
    graph.wait_until(lambda: flown_s(graph) > since + 0.1)
    assert (flown_s(graph) - since) / (time.monotonic() - wall) < 0.2
    since, wall = flown_s(graph), time.monotonic()
    assert graph.set_parameter("sim", "real_time_factor", 5.0, client).successful
    graph.wait_until(lambda: flown_s(graph) > since + 4.0)
    assert (flown_s(graph) - since) / (time.monotonic() - wall) < 5.25
    assert same_flight(graph.received["odom"], fly(Scenario(), Controller(), 2.0))

    def newest(name):
        for message in reversed(graph.received["/diagnostics"]):
            if message.status[0].name == name:
                return message
        return None

    def told_of_the_pace():
        message = newest("sim: simulator")
        values = diagnostics.decode(message.status[0]) if message else {}
        return values.get("real_time_factor_asked") == 5.0

    graph.wait_until(told_of_the_pace)
    # Nobody speaks in the wall's time, which is many years.
    for name in ("sim: simulator", "nmpc: controller"):
        graph.wait_until(lambda name=name: newest(name) is not None)
        assert stamps.decode(newest(name).header.stamp) * 1e-9 <= flown_s(graph) + 10.0
    refused = graph.set_parameter("sim", "real_time_factor", -1.0)
    assert not refused.successful
    assert "real_time_factor" in refused.reason
    assert graph.get_parameter("sim", "real_time_factor") == 5.0


def test_wind_and_gusts_change_in_flight_together_or_not_at_all(graph):
    graph.listen([topics.ODOM])
    graph.start(NMPC)
    graph.start(SIM, gust__kind="none", **LOCKSTEP)
    graph.wait_until(lambda: flown_s(graph) > 0.5)
    wind = [0.0] * 6 + [0.6, 0.4, 0.0]
    refused = graph.set_together("sim", gust__kind="gale", zeta=wind)
    assert not refused.successful
    assert "gust.kind = 'gale'" in refused.reason
    assert list(graph.get_parameter("sim", "zeta")) == [0.0] * 9
    refused = graph.set_together("sim", zeta=[0.0] * 6 + [0.9, 0.0, 0.0])
    assert "zeta[w_bx] = 0.9: allowed is -0.8 to 0.8" in refused.reason
    assert graph.set_together("sim", gust__kind="worst-case", zeta=wind).successful
    since = flown_s(graph)
    graph.wait_until(lambda: flown_s(graph) > since + 8.0)
    still = fly(Scenario(gust={"kind": "none"}), Controller(), 1.0).d_T.min()
    flown = np.array([x for t, x in sorted(positions(graph.received["odom"]).items())])
    assert Tower().clearance(flown).min() < still - 0.05


def test_bounds_weights_and_clearance_change_in_flight(graph):
    graph.listen([topics.TIGHTENING, topics.ODOM])
    graph.start(NMPC)
    graph.start(SIM, **LOCKSTEP)

    def gust_margin():
        return tightening.decode(graph.received["tightening"][-1]).alpha_g[-1]

    graph.wait_until(lambda: len(graph.received["tightening"]) > 10)
    before = gust_margin()
    taken = graph.set_together(
        "nmpc",
        uncertainty__gust_n=0.3,
        tower__min_clearance_m=0.25,
        weights__position=[40.0, 40.0, 80.0],
    )
    assert taken.successful
    graph.wait_until(lambda: gust_margin() == pytest.approx(before / 2.0))
    refused = graph.set_together("nmpc", uncertainty__gust_n=0.1, weights__rate=-1.0)
    assert not refused.successful
    refused = graph.set_parameter("nmpc", "vehicle", "octo")
    assert "read-only" in refused.reason
    at = flown_s(graph)
    graph.wait_until(lambda: flown_s(graph) > at + 0.5)
    assert gust_margin() == pytest.approx(before / 2.0)


def test_managed_nodes_publish_only_while_they_are_active(graph):
    graph.listen(LOOP)
    for module in (SIM, NMPC):
        graph.start(module, options=["--managed"])

    def ask(node, transition):
        request = ChangeState.Request(transition=TransitionMessage(label=transition))
        assert graph.call(ChangeState, f"{node}/change_state", request).success

    for node in ("sim", "nmpc"):
        ask(node, "configure")
    graph.wait_until(lambda: graph.node.count_publishers("odom") == 1)
    assert graph.set_parameter("nmpc", "mode", "nominal").successful
    for node in ("sim", "nmpc"):
        ask(node, "activate")
    graph.wait_until(lambda: flown_s(graph) > 0.2)
    assert tightening.decode(graph.received["tightening"][-1]).alpha_p.max() == 0.0

    ask("nmpc", "deactivate")
    # Begun again, the flight waits for an answer; what is on its way is for the one before.
    assert graph.call(Trigger, "sim/reset", Trigger.Request()).success
    commands, at = len(graph.received["rotor_command"]), len(graph.received["odom"])
    graph.wait_until(lambda: times_s(graph, "odom", at)[-5:] == [0.0] * 5)
    assert 0.0 not in times_s(graph, "rotor_command", commands)
    ask("nmpc", "activate")
    graph.wait_until(lambda: flown_s(graph) > 0.2)

    at = flown_s(graph)
    ask("sim", "deactivate")
    ask("sim", "cleanup")
    graph.wait_until(lambda: graph.node.count_publishers("odom") == 0)
    before = len(graph.received["odom"])
    for transition in ("configure", "activate"):
        ask("sim", transition)
    graph.wait_until(lambda: any(0.0 < t < at for t in times_s(graph, "odom", before)))
