# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Pages that are made from the code say what the code says, and every page is in a menu."""

import runpy
import sys
from pathlib import Path

import pytest
from PIL import Image

from gtmr_nmpc import ControllerConfig
from gtmr_study.cli.app import MODULES

DOCS = Path(__file__).parents[2] / "docs"
sphinx = pytest.importorskip("sphinx")


@pytest.fixture(scope="module")
def made():
    return runpy.run_path(str(DOCS / "sphinx" / "generated_pages.py"))


def test_every_command_is_described_with_its_options(made):
    page = made["commands"]()

    assert [line[8:] for line in page.splitlines() if line.startswith("## gtmr ")] == list(MODULES)
    assert "| `--seed K` |" in page
    assert "Traceback" not in page


def test_every_field_of_a_controller_is_described_with_default_and_bounds(made):
    page = made["configuration"]()

    for name in ControllerConfig.model_fields:
        assert f"| `{name}` |" in page, name
    assert (
        "| `horizon` | `20` | at least 2, at most 100 | N, number of stages (Table I). |" in page
    )
    # What is chosen by its kind is described kind by kind.
    assert "### ClosedLoopMargin" in page
    assert page.count("### Tower") == 1


def test_every_page_is_in_a_menu(monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    menus = runpy.run_path(str(DOCS / "conf.py"))["navigation"]
    listed = {page for below in menus.values() for name in below for page in pages_of(name)}
    there = {
        path.relative_to(DOCS).with_suffix("").as_posix()
        for path in [*DOCS.rglob("*.md"), *DOCS.rglob("*.rst")]
        if "reproduction" not in path.parts and "sphinx" not in path.parts
    }
    assert there - listed == {"index"}
    assert listed - there == set()


def pages_of(name):
    if "*" not in name:
        return {name}
    return {path.relative_to(DOCS).with_suffix("").as_posix() for path in DOCS.glob(f"{name}.md")}


def test_the_moving_picture_moves_loops_and_is_small():
    path = DOCS / "flight.webp"
    with Image.open(path) as picture:
        assert picture.n_frames > 50
        assert picture.info["loop"] == 0
    assert path.stat().st_size < 1_500_000
