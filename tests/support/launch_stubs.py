# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A launch file run against stand-ins for ``launch`` and ``launch_ros``, which pip lacks."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

ROOT = Path(__file__).parents[2]
STUBS = {
    "launch": ["LaunchContext", "LaunchDescription"],
    "launch.actions": [
        "DeclareLaunchArgument",
        "ExecuteProcess",
        "LogInfo",
        "OpaqueFunction",
        "RegisterEventHandler",
        "Shutdown",
    ],
    "launch.event_handlers": ["OnProcessStart"],
    "launch.events": [],
    "launch.events.process": ["ProcessExited"],
    "launch_ros": [],
    "launch_ros.actions": ["Node"],
}


def recorder(kind):
    class Recorded(SimpleNamespace):
        def __init__(self, *args, **kwargs):
            super().__init__(kind=kind, args=args, **kwargs)

    return Recorded


@pytest.fixture
def launch(monkeypatch):
    """Load a launch file and start it with some arguments."""
    for name, members in STUBS.items():
        module = ModuleType(name)
        for member in members:
            setattr(module, member, recorder(member))
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "gtmr_msgs_py.start.launching", raising=False)
    from gtmr_msgs_py.start import launching

    monkeypatch.setattr(launching, "share", lambda: ROOT)

    def start(name, viewers=(), **texts):
        monkeypatch.setattr(launching, "_is_installed", lambda package: package in viewers)
        loaded = runpy.run_path(str(ROOT / "launch" / f"{name}.launch.py"))
        (entities,) = loaded["generate_launch_description"]().args
        defaults = {e.args[0]: e.default_value for e in entities if e.kind != "OpaqueFunction"}
        context = SimpleNamespace(launch_configurations=defaults | texts)
        return loaded["ARGUMENTS"], entities[-1].function(context)

    yield start
    sys.modules.pop("gtmr_msgs_py.start.launching", None)


def parameters(node):
    """What a node is given beside the parameter file."""
    path, given = node.parameters
    assert Path(path).is_file()
    return given


def exit_of(node, returncode, is_shutdown=False):
    """What follows when its process has ended."""
    event = SimpleNamespace(returncode=returncode, process_name=f"{node.executable}-1")
    return [each.kind for each in node.on_exit(event, SimpleNamespace(is_shutdown=is_shutdown))]
