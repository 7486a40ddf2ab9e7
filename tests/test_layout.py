# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The repository is laid out as README says, in folders small enough to take in at a glance."""

import ast
import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULES = sorted((ROOT / "src").rglob("*.py"))
MOST_MODULES = 9
UNSAFE_MODULES = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}
UNSAFE_CALLS = {"os.system", "pd.read_pickle", "yaml.load", "yaml.unsafe_load", "yaml.full_load",
                "yaml.Loader", "yaml.FullLoader", "yaml.UnsafeLoader"}  # fmt: skip


def test_no_folder_holds_more_than_nine_modules():
    counts = Counter(path.parent for path in MODULES if path.name != "__init__.py")
    assert {folder: n for folder, n in counts.items() if n > MOST_MODULES} == {}


def test_readme_lists_the_packages_that_there_are():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(gtmr_\w+)`", readme, re.MULTILINE)
    assert sorted(listed) == sorted(
        path.parent.name for path in (ROOT / "src").glob("*/__init__.py")
    )


def test_no_source_can_run_what_a_file_holds_but_the_one_for_controllers_of_ones_own():
    own_controller = ROOT / "src" / "gtmr_study" / "own_controller.py"
    runs = {}
    for path in (ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Import(names=names):
                    found = {name.name for name in names} & UNSAFE_MODULES
                case ast.ImportFrom(module=module):
                    found = {module} & UNSAFE_MODULES
                case ast.Call(func=ast.Name(id=name)):
                    found = {name} & {"eval", "exec"}
                case ast.Attribute(value=ast.Name(id=module), attr=name):
                    found = {f"{module}.{name}"} & UNSAFE_CALLS
                case ast.keyword(arg=name):
                    found = {name} & {"allow_pickle", "shell"}
                case _:
                    found = set()
            if found:
                runs.setdefault(path, set()).update(found)
    assert runs == {own_controller: {"exec"}}
