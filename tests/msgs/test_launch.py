# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The launch files start what exists, with parameters that exist; `launch` itself is stubbed."""

import os
import re
from pathlib import Path

import pytest
from support.launch_stubs import exit_of, parameters

from gtmr_monitor.node import MonitorNode, MonitorParameters
from gtmr_msgs_py.node.declarations import declarations
from gtmr_msgs_py.start.parent import PARENT
from gtmr_nmpc.config import MODES
from gtmr_nmpc.node import NmpcNode, NmpcParameters
from gtmr_sim.node import SimNode, SimParameters

ROOT = Path(__file__).parents[2]
MODELS = {
    "sim": (SimParameters, SimNode),
    "nmpc": (NmpcParameters, NmpcNode),
    "monitor": (MonitorParameters, MonitorNode),
}
LAUNCHED = {
    "inspection": ["sim", "nmpc", "monitor"],
    "compare": ["sim", "nmpc", "sim", "nmpc", "monitor"],
}
# A text for every argument that is a parameter, other than its default.
TEXTS = {
    "mode": "nominal",
    "lockstep": "true",
    "vehicle": "octo",
    "world": "field",
    "controller": "field",
    "zeta": "[0, 0, 0, 0, 0, 0, 0.6, 0.4, 0]",
    "sample_zeta": "true",
    "seed": "3",
    "real_time_factor": "2",
    "duration_s": "5.0",
}


@pytest.mark.parametrize("name", LAUNCHED)
def test_the_suite_is_started_from_executables_that_exist(launch, name):
    _, nodes = launch(name)
    assert {node.package for node in nodes} == {"gtmr"}
    assert [node.executable for node in nodes] == LAUNCHED[name]
    assert all((ROOT / "scripts" / node.executable).is_file() for node in nodes)


@pytest.mark.parametrize("name", LAUNCHED)
def test_every_argument_is_described_and_reaches_the_parameter_it_names(launch, name):
    arguments, _ = launch(name)
    assert all(argument.description for argument in arguments.values())
    as_parameters = {n: a for n, a in arguments.items() if a.parameter_of}
    _, nodes = launch(name, **{n: TEXTS[n] for n in as_parameters})
    for argument, meant in as_parameters.items():
        for node in nodes:
            assert (argument in parameters(node)) == (
                node.executable in meant.parameter_of
            ) or node.executable == "sim", argument


@pytest.mark.parametrize("name", LAUNCHED)
def test_every_parameter_exists_and_has_the_type_it_is_given(launch, name):
    arguments, _ = launch(name)
    texts = {n: TEXTS[n] for n, a in arguments.items() if a.parameter_of}
    _, nodes = launch(name, bag="bags/new", **texts)
    for node in nodes:
        model, class_ = MODELS[node.executable]
        known = {d.name: d.value for d in declarations(model(), class_.PRESETS)}
        known["use_sim_time"] = False
        for parameter, value in parameters(node).items():
            assert type(known[parameter]) is type(value), parameter


def test_what_is_not_given_is_left_to_the_parameter_file(launch):
    _, nodes = launch("inspection")
    assert parameters(nodes[0]) == {"recorders": 0}
    assert parameters(nodes[1]) == {"recorders": 0, "use_sim_time": True}


def test_a_recorded_flight_waits_for_its_recorder(launch):
    _, (sim, nmpc, monitor) = launch("inspection", bag="bags/new")
    assert parameters(sim)["recorders"] == parameters(nmpc)["recorders"] == 1
    assert parameters(monitor)["bag"] == "bags/new"


def test_viewers_start_only_when_asked_for(launch):
    both = ("rviz2", "foxglove_bridge")
    _, nodes = launch("inspection", viewers=both, rviz="true", foxglove="true")
    assert [node.package for node in nodes[3:]] == ["rviz2", "foxglove_bridge"]
    assert Path(nodes[3].arguments[1]).is_file()
    assert nodes[4].parameters[0]["address"] == "127.0.0.1"


@pytest.mark.parametrize("viewer", ["rviz", "foxglove"])
def test_a_viewer_that_is_not_installed_is_named_before_anything_starts(launch, viewer):
    with pytest.raises(ValueError, match=f"{viewer}:=true needs the package {viewer}.*, which is"):
        launch("inspection", **{viewer: "true"})


def test_a_comparison_is_shown_where_its_topics_are(launch):
    _, nodes = launch("compare", viewers=("rviz2",), rviz="true", namespace="fleet")
    shown = [node for node in nodes if node.package == "rviz2"]
    assert [node.namespace for node in shown] == ["fleet/nominal", "fleet/robust"]
    assert all(("/clock", "clock") in node.remappings for node in shown)


@pytest.mark.parametrize("name", LAUNCHED)
def test_the_end_of_any_node_ends_the_launch_and_its_failure_is_one(launch, name):
    _, nodes = launch(name, respawn="0")
    for node in nodes:
        for code in (1, 2, -9):
            with pytest.raises(
                RuntimeError, match=f"{node.executable}-1 ended with exit code {code}"
            ):
                exit_of(node, code)
        assert exit_of(node, -2, is_shutdown=True) == []
        assert not node.respawn
    monitor = nodes[-1]
    assert exit_of(monitor, 0) == ["Shutdown"]


@pytest.mark.parametrize("name", [*LAUNCHED, "replay"])
def test_controller_and_monitor_start_again_so_many_times_and_no_more(launch, name):
    _, started = launch(name, bag="bags/old", respawn="2")
    again = [each for each in started if getattr(each, "executable", "") in ("nmpc", "monitor")]
    assert len(again) >= 2
    for node in again:
        # launch itself starts it again, whatever follows from its end.
        assert (node.respawn, node.respawn_max_retries) == (True, 2)
        assert node.respawn_delay > 0.0
        assert exit_of(node, -9, is_shutdown=True) == []
        assert exit_of(node, 0) == ["Shutdown"]
        with pytest.raises(RuntimeError, match="exit code 2"):
            exit_of(node, 2)
        assert [exit_of(node, code) for code in (1, -9)] == [["LogInfo"]] * 2
        with pytest.raises(RuntimeError, match="exit code -9"):
            exit_of(node, -9)
    assert not any(each.respawn for each in started if getattr(each, "executable", "") == "sim")


@pytest.mark.parametrize("name", LAUNCHED)
def test_managed_nodes_are_brought_up_whenever_they_start(launch, name):
    _, entities = launch(name, managed="true", namespace="/hex")
    nodes = [each for each in entities if each.kind == "Node"]
    watched = {id(each.args[0].target_action): each.args[0] for each in entities
               if each.kind == "RegisterEventHandler"}  # fmt: skip
    assert [node.executable for node in nodes] == LAUNCHED[name]
    for node in nodes:
        assert node.arguments == ["--managed"]
        (process,) = watched[id(node)].on_start(None, None)
        full_name = f"/{node.namespace}/{node.executable}"
        assert process.cmd == ["python3", "-m", "gtmr_msgs_py.start.bring_up", full_name]
        process.executable = "bring_up"
        assert exit_of(process, 0) == []
        with pytest.raises(RuntimeError, match="bring_up-1 ended with exit code 1"):
            exit_of(process, 1)


@pytest.mark.parametrize("name", [*LAUNCHED, "replay"])
def test_every_process_of_ours_ends_with_the_launch_whatever_ends_that(launch, name):
    _, started = launch(name, bag="bags/old")
    assert {each.additional_env[PARENT] for each in started} == {str(os.getpid())}


@pytest.mark.parametrize("name", LAUNCHED)
def test_a_namespace_has_a_clock_of_its_own(launch, name):
    _, nodes = launch(name, namespace="hex1")
    assert all(node.namespace.startswith("hex1") for node in nodes)
    assert all(("/clock", "clock") in node.remappings for node in nodes)
    assert all(node.ros_arguments == ["--log-level", "info"] for node in nodes)


def test_a_mode_that_does_not_exist_is_refused_by_launch(launch):
    arguments, _ = launch("inspection")
    assert set(arguments["mode"].choices) == {"", *MODES}


def test_two_flights_are_apart_and_end_together(launch):
    _, nodes = launch("compare", seed="3", bag="bags/new")
    sims = [node for node in nodes if node.executable == "sim"]
    assert [node.namespace for node in sims] == ["nominal", "robust"]
    modes = {n.namespace: parameters(n)["mode"] for n in nodes if n.executable == "nmpc"}
    assert modes == {"nominal": "nominal", "robust": "robust"}
    assert all(("/clock", "clock") in node.remappings for node in sims)
    assert all(parameters(node)["seed"] == 3 for node in sims)
    assert parameters(nodes[-1])["namespaces"] == ["nominal", "robust"]
    assert [exit_of(sim, 0) for sim in sims] == [[], ["Shutdown"]]


@pytest.mark.parametrize(
    ("texts", "reason"),
    [
        ({"seed": "many"}, "seed:=many: expected int"),
        ({"sample_zeta": "1"}, "sample_zeta:=1: expected bool"),
        ({"params_file": "nope"}, "params_file:=nope: there is paper, wind, worst-case"),
        ({"params_file": "nope.yaml"}, "params_file:=nope.yaml: there is"),
    ],
)
def test_an_argument_that_cannot_be_used_is_named(launch, texts, reason):
    with pytest.raises(ValueError, match=reason):
        launch("inspection", **texts)


def test_the_documentation_names_every_launch_argument_and_no_other(launch):
    page = (ROOT / "docs" / "interfaces.md").read_text(encoding="utf-8")
    there_are = {"bag"}
    for name in (*LAUNCHED, "replay"):
        arguments, _ = launch(name, bag="bags/old")
        there_are |= set(arguments)
    assert set(re.findall(r"(\w+):=", page.partition("## Parameters")[0])) == there_are
