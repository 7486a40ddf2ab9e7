"""The launch file starts what exists, with parameters that exist; `launch` itself is stubbed."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from gtmr_monitor.node import MonitorParameters
from gtmr_msgs_py.parameters import declarations
from gtmr_nmpc.node import NmpcParameters
from gtmr_sim.node import SimParameters

LAUNCH_FILE = Path(__file__).parents[1] / "launch" / "inspection.launch.py"
MODELS = {"sim": SimParameters, "nmpc": NmpcParameters, "monitor": MonitorParameters}
STUBS = {
    "launch": ["LaunchDescription"],
    "launch.actions": ["DeclareLaunchArgument", "Shutdown"],
    "launch.substitutions": ["LaunchConfiguration", "PythonExpression"],
    "launch_ros": [],
    "launch_ros.actions": ["Node"],
    "launch_ros.parameter_descriptions": ["ParameterValue"],
}


def recorder(kind):
    return lambda *args, **kwargs: SimpleNamespace(kind=kind, args=args, **kwargs)


@pytest.fixture
def description(monkeypatch):
    for name, members in STUBS.items():
        module = ModuleType(name)
        for member in members:
            setattr(module, member, recorder(member))
        monkeypatch.setitem(sys.modules, name, module)
    (entities,) = runpy.run_path(str(LAUNCH_FILE))["generate_launch_description"]().args
    return entities


def test_all_three_nodes_are_started(description):
    nodes = [entity for entity in description if entity.kind == "Node"]
    assert {node.package for node in nodes} == {"gtmr"}
    assert [node.executable for node in nodes] == list(MODELS)


def test_every_parameter_exists_and_has_the_type_it_is_given(description):
    for node in (entity for entity in description if entity.kind == "Node"):
        model = MODELS[node.executable]()
        known = {d.name: d.value for d in declarations(model, {"vehicle": "paper"})}
        (given,) = node.parameters
        for name, value in given.items():
            assert type(known[name]) is value.value_type, name


def test_every_argument_is_used_and_described(description):
    declared = {e.args[0]: e for e in description if e.kind == "DeclareLaunchArgument"}
    assert all(argument.description for argument in declared.values())
    used = set()
    for node in (entity for entity in description if entity.kind == "Node"):
        for value in node.parameters[0].values():
            source = value.args[0]
            parts = [source] if source.kind == "LaunchConfiguration" else source.args[0]
            used |= {p.args[0] for p in parts if not isinstance(p, str)}
    assert used == set(declared)


def test_the_defaults_are_those_of_the_nodes(description):
    declared = {e.args[0]: e for e in description if e.kind == "DeclareLaunchArgument"}
    known = {
        d.name: d.value
        for model in MODELS.values()
        for d in declarations(model(), {"vehicle": "paper"})
    }
    for name, argument in declared.items():
        assert argument.default_value == str(known[name]).lower()
