# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Worlds as the nodes fly them: late, noisy odometry beside the truth."""

import numpy as np
import pytest
from support.ros_graph import RosGraph

from gtmr_model import Tower
from gtmr_msgs_py import topics
from gtmr_msgs_py.messages import odometry
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import Scenario, World, fly

SIM, NMPC = "gtmr_sim.node", "gtmr_nmpc.node"
LOCKSTEP = {"lockstep": "true", "real_time_factor": "0.0"}
DELAY_S = 0.05


@pytest.fixture
def graph():
    with RosGraph() as graph:
        yield graph


@pytest.fixture
def late_world(tmp_path):
    """Nothing but a delay."""
    file = tmp_path / "late.yaml"
    file.write_text(f"odometry: {{delay_s: {DELAY_S}}}\n")
    return str(file)


def truth_of(graph):
    """Stamps [s] and true states, shape (n, 12), in order and without repetitions."""
    told = dict(map(odometry.decode, graph.received["ground_truth"]))
    return np.array(sorted(told)) * 1e-9, np.array([told[t] for t in sorted(told)])


def fly_through_nodes(graph, world, duration_s, **nmpc):
    graph.listen([topics.GROUND_TRUTH, topics.ODOM, topics.ROTOR_STATES, topics.GUARD])
    graph.start(NMPC, use_sim_time="true", **nmpc)
    sim = graph.start(SIM, world=world, duration_s=str(duration_s), recorders="1", **LOCKSTEP)
    graph.wait_until(lambda: sim.process.poll() is not None)
    assert sim.wait() == 0, sim.output
    times, flown = truth_of(graph)
    return times, flown, any(message.data for message in graph.received["guard"])


@pytest.mark.parametrize("delay_s", [0.0, DELAY_S])
def test_a_delay_of_50_ms_is_survived_only_by_who_knows_of_it(graph, late_world, delay_s):
    _, flown, guarded = fly_through_nodes(
        graph, late_world, 10.0, delay_s=str(delay_s), max_delay_s="0.2"
    )

    tower = Tower()
    radial_m = np.abs(tower.clearance(flown) - 0.35)
    tilt_rad = np.abs(flown[:, 3:5]).max()
    is_lost = guarded or tilt_rad > 0.5 or radial_m.max() > 0.5
    assert is_lost == (delay_s == 0.0), (guarded, tilt_rad, radial_m.max())


@pytest.mark.parametrize("world", ["field", "hard"])
def test_a_flight_in_a_world_is_the_flight_in_process(graph, world):
    times, flown, _ = fly_through_nodes(graph, world, 2.0, controller=world, mode="offset_free")

    scenario = Scenario(world=World.load("world", world))
    controller = Controller(ControllerConfig.load("controller", world), "offset_free")
    log = fly(scenario, controller, 2.0)
    # The last instant is the end of the last step.
    assert times[:-1] == pytest.approx(log.t)
    assert np.abs(flown[:-1, :3] - log.x[:, :3]).max() < 1e-9
    measured = dict(map(odometry.decode, graph.received["odom"]))
    assert set(np.round(np.array(sorted(measured)) * 1e-9, 6)) < set(
        np.round(np.arange(0.0, 2.0, 0.005), 6)
    )
    assert not np.allclose(measured[0][:3], flown[0, :3], atol=1e-4)
