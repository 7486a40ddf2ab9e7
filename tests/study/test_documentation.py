# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What README and the documentation name is there, and asking for help costs little."""

import importlib
import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "examples" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
DOTTED = re.compile(r"\bgtmr_[a-z_]+(?:\.[A-Za-z_]+)+")
PATH = re.compile(r"\bgtmr_[a-z_]+(?:/[A-Za-z_]+)*/[A-Za-z_]+\.(?:py|c|h)\b")
TOO_LARGE = (
    "casadi", "dask", "distributed", "gtmr_nmpc", "matplotlib", "numpy", "optuna", "pandas",
    "plotly", "pydantic", "rosbags", "scipy",
)  # fmt: skip


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_modules_that_are_named_are_there(page):
    text = page.read_text(encoding="utf-8")

    missing = [name for name in PATH.findall(text) if not (ROOT / "src" / name).is_file()]
    missing += [name for name in DOTTED.findall(text) if not is_there(name)]

    assert missing == []


def is_there(dotted):
    """Tell whether a name is a module, or something in one."""
    *modules, last = dotted.split(".")
    place = (ROOT / "src").joinpath(*modules)
    if (place / last).is_dir() or (place / f"{last}.py").is_file():
        return True
    if not place.is_dir() and not place.with_suffix(".py").is_file():
        return False
    return hasattr(importlib.import_module(".".join(modules)), last)


def test_help_of_the_command_line_loads_nothing_large():
    code = (
        "import sys, gtmr_study.cli.app as cli\n"
        "sys.argv = ['gtmr', '--help']\n"
        "try: cli.main()\n"
        f"finally: print([m for m in {TOO_LARGE} if m in sys.modules], file=sys.stderr)"
    )

    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )

    assert "campaign" in run.stdout
    assert run.stderr.strip() == "[]"


def test_mistakes_made_on_purpose_can_still_be_made_and_are_those_in_the_docs():
    script = ROOT / "bench" / "mutations.py"
    told = subprocess.run(
        [sys.executable, script, "--table"], capture_output=True, text=True, check=True
    ).stdout
    assert told in (ROOT / "docs" / "testing.md").read_text(encoding="utf-8")
    for name, text, _, test in runpy.run_path(str(script))["MUTATIONS"]:
        assert (ROOT / name).read_text(encoding="utf-8").count(text) == 1, (name, text)
        file, _, function = test.partition("::")
        assert f"def {function.partition('[')[0]}" in (ROOT / file).read_text(encoding="utf-8")


def test_the_page_of_worlds_says_what_was_measured():
    module = runpy.run_path(str(ROOT / "docs" / "field.py"))
    kept = json.loads((ROOT / "docs" / "field" / "results.json").read_text(encoding="utf-8"))
    text = (ROOT / "docs" / "field.md").read_text(encoding="utf-8")
    assert module["page"](text, kept) == text
    flown = [told for told in kept.values() if told.get("mode") == "offset_free"]
    assert len(flown) >= 7


def test_the_page_of_the_arena_says_what_was_flown():
    module = runpy.run_path(str(ROOT / "docs" / "arena.py"))
    text = module["PAGE"].read_text(encoding="utf-8")
    assert module["page"](text) == text, "run python docs/arena.py"
    results = json.loads((module["KEPT"] / "arena.json").read_text(encoding="utf-8"))
    assert {result["world"] for result in results} == {"paper", "field", "hard"}
    assert not any(result["missing"] for result in results)


def test_a_measurement_that_lacks_a_solver_is_not_published(tmp_path):
    module = runpy.run_path(str(ROOT / "docs" / "performance.py"))
    few, other = tmp_path / "few.json", tmp_path / "other.json"
    few.write_text('{"controller": {}, "rivals": {}, "qp": {}}', encoding="utf-8")
    other.write_text("{}", encoding="utf-8")
    for file, said in ((few, "PIQP"), (other, "neither")):
        with pytest.raises(SystemExit, match=said):
            module["keep"]({}, file)


def test_the_pages_say_of_speed_what_was_measured():
    module = runpy.run_path(str(ROOT / "docs" / "performance.py"))
    kept = json.loads(module["KEPT"].read_text(encoding="utf-8"))
    made = module["pages"](kept)
    assert set(made) == {ROOT / "docs" / "performance.md", ROOT / "README.md"}
    for page, text in made.items():
        assert text == page.read_text(encoding="utf-8"), page
    assert {"DAQP", "PIQP"} < set(kept["bench"]["qp"]["robust"]["recovery"])
