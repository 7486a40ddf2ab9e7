# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A robot has only what the nodes need; the rest says in one line how to get it."""

import subprocess
import sys
from importlib.metadata import requires

import pytest

STUDY = [line.partition(";")[0] for line in requires("gtmr") if 'extra == "study"' in line]
RUN = """
import sys
sys.modules.update(dict.fromkeys(sys.argv.pop(1).split(",")))
"""


def without(missing, code, *arguments):
    """Run Python as where some packages are not installed."""
    command = [sys.executable, "-c", RUN + code, ",".join(missing), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("missing", "arguments"),
    [
        ("typer", ["fly"]),
        ("dask", ["campaign", "--trials", 1, "--scheduler", "tcp://127.0.0.1:1"]),
        ("plotly", ["report", "bags/mine"]),
    ],
)
def test_a_command_names_what_is_missing_and_how_to_get_it(tmp_path, missing, arguments):
    out = ["--out", tmp_path / "out.html"] if arguments[0] != "fly" else []

    ended = without([missing], "from gtmr_study.cli import main; main()", *arguments, *out)

    said = f"gtmr {arguments[0]} needs {missing}: pip install 'gtmr[study]'\n"
    assert (ended.returncode, ended.stdout, ended.stderr) == (2, "", said)


def test_the_nodes_need_nothing_of_the_study():
    pytest.importorskip("rclpy")
    nodes = "import gtmr_sim.node, gtmr_nmpc.node, gtmr_monitor.node"

    ended = without([*STUDY, "viser", "optuna"], nodes)

    assert len(STUDY) > 5
    assert ended.returncode == 0, ended.stderr
