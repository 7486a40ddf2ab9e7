# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A parameter name that does not exist is refused, wherever it was given."""

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from gtmr_model import ConfigError
from gtmr_msgs_py.node.given_names import refuse_unknown_names
from gtmr_msgs_py.node.parameters import ModelParameters
from gtmr_sim.node import SimNode, SimParameters


@pytest.fixture
def start(tmp_path):
    """Declare the simulator's parameters with a command line; texts become parameter files."""
    contexts = []

    def started(*args, file=""):
        if file:
            path = tmp_path / "parameters.yaml"
            path.write_text(file)
            args = ("--params-file", str(path), *args)
        context = Context()
        command_line = ["sim", "--ros-args", *args]
        rclpy.init(args=command_line, context=context, domain_id=101)
        contexts.append(context)
        node = Node("sim", context=context)
        ModelParameters(node, SimParameters, SimNode.PRESETS)
        try:
            refuse_unknown_names(node, command_line)
        finally:
            node.destroy_node()

    yield started
    for context in contexts:
        rclpy.shutdown(context=context)


def section(names, node="/**"):
    return f"{node}:\n  ros__parameters:\n    {names}\n"


def test_what_exists_is_taken(start):
    start("-p", "seed:=3", "-p", "use_sim_time:=false", file=section("tower: {radius_m: 1.2}"))


@pytest.mark.parametrize(
    ("given", "hint"),
    [
        ("seeed:=3", "seeed: the closest is seed"),
        ("sim:seeed:=3", "seeed: the closest is seed"),
        ("tower.radius:=1.2", "tower.radius: the closest is tower.radius_m"),
        ("horizon:=30", "horizon: it is one of nmpc"),
    ],
)
def test_a_name_on_the_command_line_must_be_one_of_the_node(start, given, hint):
    with pytest.raises(ConfigError, match=f"sim: there is no parameter {hint}"):
        start("-p", given)


def test_a_section_for_any_node_may_name_what_another_node_has(start):
    start(file=section("{horizon: 20, bag: '', seed: 3}"))


def test_values_as_launch_writes_them_are_no_obstacle(start):
    start(file=section("{horizon: 20, namespaces: !!python/tuple ['', hex1]}"))


@pytest.mark.parametrize("node", ["sim", "/sim", "/**/sim"])
def test_a_section_for_one_node_may_not(start, node):
    with pytest.raises(ConfigError, match="no parameter horizon: it is one of nmpc"):
        start(file=section("horizon: 20", node))


def test_a_section_for_any_node_may_not_name_what_no_node_has(start):
    with pytest.raises(ConfigError, match="no parameter horizonn: the closest is horizon"):
        start(file=section("{horizonn: 20, seed: 3}"))


def test_a_section_for_another_node_is_its_own_affair(start):
    start(file=section("horizonn: 20", "nmpc"))
