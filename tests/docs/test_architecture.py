# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The picture of the packages shows the imports that there are."""

import re
import runpy
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_picture_is_the_one_that_the_imports_give():
    drawn = (DOCS / "architecture.svg").read_text(encoding="utf-8")
    module = runpy.run_path(str(DOCS / "architecture.py"))

    assert drawn == module["picture"](), "run python docs/architecture.py"

    shown = {tuple(pair.split()) for pair in re.findall(r'data-imports="([^"]+)"', drawn)}
    assert shown == {(a, b) for a, below in module["imports"]().items() for b in below}
    assert ("gtmr_sim", "gtmr_model") in shown
    assert ("gtmr_model", "gtmr_sim") not in shown


def test_the_picture_has_every_package():
    packages = {path.parent.name for path in (DOCS.parent / "src").glob("*/__init__.py")}
    assert set(runpy.run_path(str(DOCS / "architecture.py"))["LAYERS"]) == packages
