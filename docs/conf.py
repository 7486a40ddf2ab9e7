# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How the site is built: `make docs` runs Sphinx with this, and every warning is an error."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS / "sphinx"))

project = "gtmr"
author = "the gtmr authors"
project_copyright = f"2026 {author}"
version = release = version_of("gtmr")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "numpydoc",
    # Our own, in docs/sphinx.
    "api",
    "generated_pages",
    "mathml",
    "navigation",
    "sources",
]
exclude_patterns = ["sphinx"]
nitpicky = True
# They would make one dash of the two of an option.
smartquotes = False
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
# As GitHub writes formulas that stand alone.
myst_fence_as_directive = ["math"]

navigation = {
    "index": [
        "start",
        "concepts",
        "tutorials/index",
        "how-to/index",
        "reference/index",
        "results",
        "contributing",
        "faq",
        "changelog",
    ],
    "concepts": [
        "method",
        "margins",
        "offset-free",
        "worlds",
        "guard",
        "airframe",
        "level-flight",
        "solver",
        "architecture",
    ],
    "tutorials/index": [
        "tutorials/own-vehicle",
        "tutorials/own-tower",
        "tutorials/own-controller",
        "tutorials/own-gust",
        "tutorials/own-scenario",
        "tutorials/tune-weights",
        "tutorials/read-a-bag",
        "tutorials/notebook",
        "tutorials/to-an-aircraft",
        "tutorials/examples",
    ],
    "how-to/index": ["how-to/*"],
    "reference/index": [
        "reference/command-line",
        "reference/configuration",
        "interfaces",
        "reference/api/*",
        "security",
    ],
    "results": ["reproduction", "field", "arena", "performance", "reliability"],
    "contributing": ["testing"],
}
"""Which pages stand below which, for the menus; the pages themselves know nothing of it."""

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True, "imported-members": True}
# Members are listed already, each with its docstring.
numpydoc_show_class_members = False

html_theme = "pydata_sphinx_theme"
html_title = f"gtmr {version}"
html_static_path = ["sphinx/static"]
html_favicon = "sphinx/static/favicon.svg"
html_css_files = ["site.css"]
# A page that is opened from the disk cannot read others for a summary.
html_show_search_summary = False
html_show_sourcelink = False
html_copy_source = False
html_context = {"default_mode": "auto"}
# Pages without others below them need no menu of these.
html_sidebars = {page: [] for page in ("start", "faq", "changelog")}
html_theme_options = {
    "logo": {"text": "gtmr"},
    "navbar_align": "left",
    "header_links_before_dropdown": 9,
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
