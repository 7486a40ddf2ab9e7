# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the documentation says of topics, services and parameters is what the code has."""

import re
import runpy
from pathlib import Path

import pytest
import rclpy
import yaml
from rclpy.context import Context
from rclpy.node import Node

from gtmr_model import YamlModel
from gtmr_monitor.node import MonitorNode, MonitorParameters
from gtmr_msgs_py.node.declarations import declarations
from gtmr_msgs_py.node.parameters import ModelParameters
from gtmr_nmpc.node import NmpcNode, NmpcParameters
from gtmr_sim.node import SimNode, SimParameters

ROOT = Path(__file__).parents[2]
PAGES = [
    page.read_text(encoding="utf-8")
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
]
NODES = {
    "sim": (SimNode, SimParameters),
    "nmpc": (NmpcNode, NmpcParameters),
    "monitor": (MonitorNode, MonitorParameters),
}
FILES = sorted((ROOT / "config" / "ros").glob("*.yaml"))


def declared(name):
    node, model = NODES[name]
    return {d.name: d for d in declarations(model(), node.PRESETS, node.DYNAMIC)}


def given(path):
    """Parameters of a file, by dotted name."""

    def flat(tree, above=()):
        for key, value in tree.items():
            if isinstance(value, dict):
                yield from flat(value, (*above, key))
            else:
                yield ".".join((*above, key)), value

    return dict(flat(yaml.safe_load(path.read_text(encoding="utf-8"))["/**"]["ros__parameters"]))


@pytest.fixture
def load():
    """Declare the parameters of a node that is started with a parameter file."""
    contexts = []

    def load(name, path):
        context = Context()
        rclpy.init(args=["--ros-args", "--params-file", str(path)], context=context, domain_id=101)
        contexts.append(context)
        node_class, model = NODES[name]
        node = Node(name, context=context, namespace="hex1")
        try:
            return ModelParameters(node, model, node_class.PRESETS, node_class.DYNAMIC).value
        finally:
            node.destroy_node()

    yield load
    for context in contexts:
        rclpy.shutdown(context=context)


@pytest.mark.parametrize(
    ("file", "text"), [("PAGE", "page"), ("PARAMETER_FILE", "parameter_file")]
)
def test_what_is_generated_is_up_to_date(file, text):
    generator = runpy.run_path(str(ROOT / "docs" / "interfaces.py"))
    assert generator[file].read_text(encoding="utf-8") == generator[text](), (
        "run .venv/bin/python docs/interfaces.py"
    )


@pytest.mark.parametrize("name", NODES)
def test_the_file_of_all_parameters_is_that_of_the_defaults(load, name):
    assert load(name, ROOT / "config" / "parameters.yaml") == NODES[name][1]()


@pytest.mark.parametrize("name", NODES)
def test_parameters_named_in_the_documentation_exist(name):
    known = declared(name)
    for page in PAGES:
        for line in page.splitlines():
            if f"gtmr {name} --ros-args" in line:
                assert set(re.findall(r"-p (\S+?):=", line)) <= known.keys() | {"use_sim_time"}
            for parameter in re.findall(rf"ros2 param set /{name} (\S+)", line):
                assert not known[parameter].descriptor.read_only, parameter


@pytest.mark.parametrize("name", NODES)
def test_what_is_called_dynamic_exists(name):
    node, _ = NODES[name]
    for dynamic in node.DYNAMIC:
        assert any(p == dynamic or p.startswith(f"{dynamic}.") for p in declared(name)), dynamic


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_parameter_files_name_only_parameters_that_exist(path):
    known = set().union(*(declared(name) for name in NODES))
    assert given(path).keys() <= known


@pytest.mark.parametrize("name", NODES)
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_node_takes_from_a_parameter_file_what_is_its_own(load, name, path):
    config = load(name, path)
    for parameter, value in given(path).items():
        if parameter not in declared(name):
            continue
        taken = config
        for part in parameter.split("."):
            taken = getattr(taken, part)
        if isinstance(taken, YamlModel):
            assert taken == type(taken).load(parameter, value)
        else:
            assert taken == (tuple(value) if isinstance(value, list) else value), parameter


def test_the_security_policy_is_that_of_the_code():
    generator = runpy.run_path(str(ROOT / "docs" / "security.py"))
    assert generator["POLICY"].read_text() == generator["policy"](), (
        "run .venv/bin/python docs/security.py"
    )
