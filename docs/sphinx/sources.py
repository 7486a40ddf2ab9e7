# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Links from a page to files of the repository lead to pages that show these files.

What is linked to as ``../src/gtmr_model/tower.py`` works where the Markdown is read beside the
files, and in the site too. A link to what is not there fails the build.
"""

import html
from pathlib import Path
from typing import Any

from docutils import nodes
from pygments.util import ClassNotFound
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.transforms import SphinxTransform

ROOT = Path(__file__).parents[2]
PAGES = {
    "README.md": "index",
    "CHANGELOG.rst": "changelog",
    "examples/README.md": "tutorials/examples",
    "examples/read_a_bag.ipynb": "tutorials/notebook",
}
"""Files that are pages of the site under another name."""
LARGEST = 200_000
"""Bytes of a file that is shown."""


class LinkedFiles(SphinxTransform):
    """Turns links to files, for Sphinx downloads, into links to pages that show them."""

    default_priority = 400

    def apply(self, **_: Any) -> None:
        """Go over a page."""
        for node in list(self.document.findall(addnodes.download_reference)):
            link = link_to(self.env, str(node["reftarget"]), node)
            if link is not None:
                node.replace_self(link)
        # What is neither a page nor a file may be a folder.
        for node in list(self.document.findall(addnodes.pending_xref)):
            if node.get("reftype") == "myst" and not node.get("refdomain"):
                link = link_to(self.env, str(node["reftarget"]), node)
                if link is not None:
                    node.replace_self(link)


def link_to(env: BuildEnvironment, target: str, node: nodes.Element) -> nodes.Node | None:
    """Make the link to a file or folder of the repository; None if there is no such thing."""
    page = env.docname
    path = (Path(env.doc2path(page)).parent / target.partition("#")[0]).resolve()
    if not path.is_relative_to(ROOT) or not path.exists():
        return None
    name = path.relative_to(ROOT).as_posix()
    inner = nodes.inline("", "", *[child.deepcopy() for child in node.children])
    if name in PAGES:
        return addnodes.pending_xref(
            "", inner, refdomain="std", reftype="doc", reftarget=f"/{PAGES[name]}",
            refdoc=page, refexplicit=True, refwarn=True,
        )  # fmt: skip
    if not hasattr(env, "linked_files"):
        env.linked_files = {}  # type: ignore[attr-defined]
    env.linked_files.setdefault(page, set()).add(name)  # type: ignore[attr-defined]
    up = "../" * page.count("/")
    return nodes.reference("", "", inner, internal=True, refuri=f"{up}source/{name}.html")


def forget(app: Sphinx, env: BuildEnvironment, page: str) -> None:
    """Drop what a page linked to before it is read again."""
    getattr(env, "linked_files", {}).pop(page, None)


def collect(app: Sphinx) -> Any:
    """Yield the pages that show the files that were linked to, and what is in linked folders."""
    names = set().union(*getattr(app.env, "linked_files", {}).values())
    todo, done = sorted(names), set()
    while todo:
        name = todo.pop()
        if name in done:
            continue
        done.add(name)
        path = ROOT / name
        if path.is_dir():
            inside = sorted(each for each in path.iterdir() if shown(each))
            todo += [each.relative_to(ROOT).as_posix() for each in inside if each.is_file()]
            body = listing(path, inside)
        else:
            body = content(app, path)
        title = html.escape(name)
        yield (
            f"source/{name}",
            {"title": title, "body": f"<h1>{title}</h1>{body}"},
            "page.html",
        )


def shown(path: Path) -> bool:
    """Tell whether a folder's page lists this."""
    return path.is_file() and path.name[0] not in "._" and path.suffix not in {".pyc"}


def listing(folder: Path, inside: list[Path]) -> str:
    """List a folder."""
    entries = [
        f'<li><a href="{folder.name}/{html.escape(path.name)}.html">'
        f"{html.escape(path.name)}</a></li>"
        for path in inside
    ]
    return f"<ul>{''.join(entries)}</ul>"


def content(app: Sphinx, path: Path) -> str:
    """Show a file, or say how large it is if it is no text."""
    data = path.read_bytes()
    if b"\0" in data or len(data) > LARGEST or path.suffix in {".gz", ".png", ".pdf"}:
        return f"<p>A file of {len(data) / 1000:.0f} kB, which is not shown here.</p>"
    text = data.decode("utf-8", "replace")
    language = {".py": "python", ".yaml": "yaml", ".md": "md", ".json": "json", ".c": "c"}
    try:
        return str(
            app.builder.highlighter.highlight_block(  # type: ignore[attr-defined]
                text, language.get(path.suffix, "text"), linenos=False
            )
        )
    except ClassNotFound:
        return f"<pre>{html.escape(text)}</pre>"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_transform(LinkedFiles)
    app.connect("env-purge-doc", forget)
    app.connect("html-collect-pages", collect)
    return {"parallel_read_safe": False}
