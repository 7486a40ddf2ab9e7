# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The pages of the Python interface: docstrings as they are, without what pydantic adds."""

import re
from typing import Any

from pydantic import BaseModel
from sphinx.application import Sphinx


def shorten(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, signature: str, returns: str
) -> tuple[str, str] | None:
    """Leave out the arguments of a configuration: its fields follow, each with its meaning."""
    if what == "class" and isinstance(thing, type) and issubclass(thing, BaseModel):
        return ("(…)", "")
    return None


def quote(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Set names in single quotes as code: they are what is near, not always a documented name."""
    lines[:] = [re.sub(r"(?<![`:\w])`([^`]+)`(?![`_])", r"``\1``", line) for line in lines]
    # Bars are absolute values.
    lines[:] = [line if "``" in line else line.replace("|", r"\|") for line in lines]


def skip(
    app: Sphinx, what: str, name: str, thing: Any, skipped: bool, options: Any
) -> bool | None:
    """Leave out what pydantic and Protocols add to every class."""
    return True if name.startswith("model_") or name == "_abc_impl" else None


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("autodoc-process-signature", shorten)
    # Before numpydoc, which has the usual priority.
    app.connect("autodoc-process-docstring", quote, priority=400)
    app.connect("autodoc-skip-member", skip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
