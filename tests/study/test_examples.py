# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Every example runs as it stands, says something, and leaves the repository as it was."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
ALL = sorted(EXAMPLES.glob("[0-9][0-9]_*.py"))
PLACES = ("bags", "bench", "config", "docs", "examples", "src")


@pytest.mark.parametrize("example", ALL, ids=lambda path: path.stem)
def test_an_example_runs_as_it_stands_and_writes_nothing_here(example, tmp_path):
    before = files()
    ended = subprocess.run(
        [sys.executable, example],
        cwd=tmp_path,
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1", "TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )

    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.count("\n") >= 2
    assert ended.stderr == "" or ended.stderr.startswith("gtmr: compiling")
    assert files() == before


def files():
    """Files of the repository with their times of change; bytecode is no matter of an example."""
    found = [file for file in ROOT.iterdir() if file.is_file()]
    found += [file for place in PLACES for file in (ROOT / place).rglob("*") if file.is_file()]
    return {file: file.stat().st_mtime_ns for file in found if file.suffix != ".pyc"}


def test_the_index_has_every_example_in_order():
    text = (EXAMPLES / "README.md").read_text(encoding="utf-8")

    assert re.findall(r"`python examples/(\w+\.py)`", text) == [file.name for file in ALL]
