# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What README, the documentation and the examples' index tell a reader to type works.

The convention of their blocks, by the word after the opening fence:

- ``python`` runs, a page's blocks one after the other in one namespace, in a folder of their own.
  A first line ``# name.py`` also writes it to that file, for the commands below it.
- ``yaml`` is a configuration, a study, or parameters of the nodes; it is read as what it is. A
  first line ``# name.yaml`` also writes it to that file.
- ``bash`` is what a reader types. Short commands of ``gtmr`` run; of long ones every option and
  file is checked, as it is of ``ros2``, ``make``, ``python`` and ``pytest``.
- ``text`` is output, or a drawing. ``math`` is a formula.

Any other block, or one without a word, fails.
"""

import contextlib
import io
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest
import yaml
from pydantic import ValidationError

from gtmr_model import ConfigError, Vehicle
from gtmr_monitor.node import MonitorParameters
from gtmr_nmpc import ControllerConfig
from gtmr_nmpc.node import NmpcParameters
from gtmr_sim import EFFECTS, GUSTS, World
from gtmr_sim.node import SimParameters
from gtmr_study.campaign.study import Study
from gtmr_study.cli.app import MODULES, Commands

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "examples" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
BLOCK = re.compile(r"^( *)(```+|~~~+)([^\n`]*)\n(.*?)^\1\2 *$", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?:\A|\n\n)    (?![ *-])\S.*\n")
FILE_NAME = re.compile(r"# (\S+\.(?:py|yaml))\s")
LOOP = re.compile(r"^for (\w+) in ([^;]+); do\n(.*?)^done$", re.MULTILINE | re.DOTALL)
KNOWN = {"python", "yaml", "bash", "text", "math", "{eval-rst}"}
SHORT = {"fly", "report", "replay", "recover", "export-c"}
"""Commands that take seconds at most, as the pages call them."""
OTHERS = {"source", "cd", "pip", "colcon", "export", "rviz2", "sudo", "apt", "git", "cmake",
          "jupyter", "cp", "ctest", "mkdir"}  # fmt: skip
"""Programs that are not ours."""
NODES = {"sim": SimParameters, "nmpc": NmpcParameters, "monitor": MonitorParameters}
MODELS = (Vehicle, ControllerConfig, World, Study)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where a reader is: as the root of the repository, with a bag that may be written to."""
    for name in ("config", "docs", "examples", "launch", "rviz", "tests", "bench"):
        (tmp_path / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "bags" / "sample", tmp_path / "bags" / "sample")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    mpl.use("agg")
    # What a page registers is for its readers, not for the tests after it.
    for registry in (GUSTS, EFFECTS):
        monkeypatch.setattr(registry, "_registered", dict(registry._registered))
    return tmp_path


def blocks_of(text):
    return [(kind.strip(), block) for _, _, kind, block in BLOCK.findall(text)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_says_to_type_works(page, folder, gtmr):
    text = page.read_text(encoding="utf-8")
    namespace = {"__name__": page.stem}
    for kind, block in blocks_of(text):
        assert kind in KNOWN, f"a block of kind {kind!r}:\n{block}"
        if (named := FILE_NAME.match(block)) and kind in ("python", "yaml"):
            Path(named[1]).write_text(block, encoding="utf-8")
        if kind == "python":
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile(block, f"{page.name}: {block[:40]!r}", "exec"), namespace)
        elif kind == "yaml":
            read(block)
        elif kind == "bash":
            for line in lines(block):
                try_line(line, gtmr)
    assert INDENTED.search(BLOCK.sub("", text)) is None, "an indented block has no word"


def lines(block):
    """Split what is typed into commands; what a loop repeats is taken for each of its words."""
    for name, values, body in LOOP.findall(block):
        for value in values.split():
            yield from lines(body.replace(f"${name}", value))
    block = LOOP.sub("", block)
    for line in block.replace("\\\n", " ").splitlines():
        yield from (part.strip() for part in re.sub(r"(^|\s)#.*", "", line).split("&&"))


def read(block):
    """Read a YAML block as what it is."""
    data = yaml.safe_load(block)
    if all(isinstance(value, dict) and "ros__parameters" in value for value in data.values()):
        for node, value in data.items():
            parameters(node, value["ros__parameters"])
        return
    problems = []
    for model in MODELS:
        try:
            model.model_validate(data)
            return
        except (ValidationError, ConfigError) as error:
            problems.append(f"{model.__name__}: {error}")
    raise AssertionError("\n".join(problems))


def parameters(node, given):
    """Check names and values of a node's parameters, or of those of any node."""
    name = node.rpartition("/")[2]
    models = [NODES[name]] if name in NODES else list(NODES.values())
    nested = {}
    for parameter, value in given.items():
        *above, last = parameter.split(".")
        place = nested
        for part in above:
            place = place.setdefault(part, {})
        place[last] = value
    nested.pop("use_sim_time", None)
    for key, value in nested.items():
        takers = [model for model in models if key in model.model_fields]
        assert takers, f"{node} has no parameter {key}"
        for model in takers:
            model.model_validate({key: value})


def try_line(line, gtmr):
    """Run a short command; check what can be checked of another."""
    words = shlex.split(line)
    match words:
        case []:
            pass
        case ["gtmr", command, *rest]:
            try_gtmr(command, rest, gtmr)
        case ["ros2", "run", "gtmr", node, *rest]:
            assigned = [word for word in rest if ":=" in word]
            given = (word.split(":=", 1) for word in assigned if not word.startswith("__"))
            parameters(node, {name: yaml.safe_load(value) for name, value in given})
        case ["ros2", "param", "set", node, name, value]:
            parameters(node, {name: yaml.safe_load(value)})
        case ["ros2", "launch", "gtmr", file, *rest]:
            assert (ROOT / "launch" / file).is_file(), file
            told = (ROOT / "docs" / "interfaces.md").read_text(encoding="utf-8")
            for word in rest:
                name, given, _ = word.partition(":=")
                assert word == "--show-args" or (given and f"`{name}:=" in told), word
        case ["ros2", verb, *_]:
            assert verb in {"bag", "node", "param", "security", "service", "topic", "lifecycle"}
        case ["make", *targets]:
            makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
            for target in targets:
                known = re.search(rf"^{re.escape(target)}[^=\n]*:", makefile, re.MULTILINE)
                assert known or "=" in target, target
        case ["python" | "python3", "-m", "venv", *_]:
            pass
        case ["python" | "python3", script, *_]:
            assert Path(script).is_file() or (Path(script) / "__main__.py").is_file(), script
        case ["pytest", *rest]:
            for word in rest:
                assert word.startswith("-") or Path(word.partition("::")[0]).exists(), word
        case ["printf" | "echo", *_]:
            subprocess.run(["sh", "-c", line], check=True)
        case [program, *_]:
            assert program.partition("=")[0].isupper() or program in OTHERS, line


def try_gtmr(command, rest, gtmr):
    if "--help" in (command, *rest) or command == "--version":
        return
    assert command in MODULES, command
    # Of campaigns that are not flown here no report can be made.
    if command in SHORT and (command != "report" or Path(rest[0]).exists()):
        ended = gtmr(command, *rest)
        assert ended.returncode == 0, f"gtmr {command} {' '.join(rest)}: {ended.stderr}"
        return
    for word in rest:
        if word.endswith((".yaml", ".yml")):
            assert Path(word).is_file(), word
    known = Commands(name="gtmr").get_command(None, command)
    with known.make_context(command, list(rest)):
        pass


def test_the_notebook_runs(folder):
    cells = json.loads((ROOT / "examples" / "read_a_bag.ipynb").read_text("utf-8"))["cells"]
    namespace = {}
    plt.close("all")
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        for cell in cells:
            assert not cell.get("outputs"), "outputs are not kept: they would grow old"
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), cell["id"], "exec"), namespace)

    assert "least clearance" in said.getvalue()
    assert len(plt.get_fignums()) == 2
    plt.close("all")


@pytest.mark.parametrize(
    "wrong",
    [
        "gtmr fly --no-such-option",
        "gtmr campaign --no-such-option",
        "gtmr campaign --scenario absent.yaml --out there",
        "gtmr no-such-command",
        "ros2 run gtmr nmpc --ros-args -p no_such_parameter:=1",
        "ros2 run gtmr nmpc --ros-args -p horizon:=1",
        "ros2 param set /nmpc mode daring",
        "ros2 launch gtmr inspection.launch.py no_such_argument:=1",
        "make no-such-target",
        "python docs/absent.py",
        "unheard-of program",
    ],
)
def test_a_line_that_would_not_work_is_found(wrong, folder, gtmr):
    # What wrong options raise is a class of the command line's own.
    with pytest.raises(Exception):  # noqa: B017, PT011
        try_line(wrong, gtmr)


def test_a_block_of_another_kind_is_found():
    assert blocks_of("```\nx\n```\n\n```sh\ny\n```\n") == [("", "x\n"), ("sh", "y\n")]
    assert INDENTED.search("What to type\n\n    gtmr fly\n") is not None
