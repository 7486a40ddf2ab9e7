# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Menus from the table in conf.py: the pages stay plain Markdown, wherever they are read."""

from typing import Any

from sphinx.application import Sphinx


def add_menu(app: Sphinx, page: str, source: list[str]) -> None:
    """Put a hidden table of contents below a page that has others below it."""
    below = app.config.navigation.get(page)
    if below is None:
        return
    source[0] += "\n\n```{toctree}\n:hidden:\n:glob:\n\n" + "\n".join(f"/{name}" for name in below)
    source[0] += "\n```\n"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_config_value("navigation", {}, "env", dict)
    app.connect("source-read", add_menu)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
