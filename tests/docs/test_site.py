# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The site is built, a broken link in it fails, and everybody can read and search it offline."""

import subprocess
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from support import chromium

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PAGES = (
    "index",
    "start",
    "concepts",
    "method",
    "architecture",
    "tutorials/notebook",
    "tutorials/examples",
    "how-to/index",
    "reference/command-line",
    "reference/configuration",
    "reference/api/nmpc",
    "interfaces",
    "reproduction",
    "changelog",
    "source/examples/01_fly.py",
    "source/config/vehicle",
)
"""Pages of every kind."""
REACHABLE = (
    "[...document.querySelectorAll('pre, .pst-scrollable-table-container')]"
    ".every((e) => e.scrollWidth <= e.clientWidth || e.tabIndex == 0)"
)
"""Whether a keyboard can scroll every table and every block."""
SIDEWAYS = (
    "[...document.querySelectorAll('body *')].filter((e) => e.scrollWidth > e.clientWidth + 1"
    " && ['auto', 'scroll'].includes(getComputedStyle(e).overflowX)"
    " && !e.matches('pre, .highlight, .pst-scrollable-table-container, .formula, dialog *'))"
    ".map((e) => e.outerHTML.slice(0, 80))"
)
"""What scrolls sideways and should not: anything but tables, blocks and formulas."""
BROKEN = {
    "page": "absent-page.md",
    "file": "../src/gtmr_model/absent.py",
    "folder": "../absent-folder",
    "heading": "#absent-heading",
    "heading of another page": "other.md#absent-there",
    "picture": "absent.png",
}


def build(source, out):
    options = ("--builder", "html", "--fail-on-warning", "--keep-going", "--quiet")
    return subprocess.run(
        [sys.executable, "-m", "sphinx", *options, "--doctree-dir", out / "doctrees", source, out],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder of the site."""
    out = tmp_path_factory.mktemp("site")
    built = build(ROOT / "docs", out)
    assert built.returncode == 0, built.stderr
    return out


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.fixture(scope="module")
def address(site):
    """Address of the site on a server of this machine: axe reads style sheets by it."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=site)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture(scope="module")
def browser():
    """One browser for all pages."""
    if chromium.find() is None:
        pytest.skip("no Chromium")
    with chromium.Page("about:blank") as page:
        yield page


def show(browser, url):
    browser.requests.clear()
    browser.complaints.clear()
    browser.call("Page.navigate", url=url)
    address, _, asked = url.partition("?")
    there = f"location.href.startsWith('{address}') && location.search.endsWith('{asked}')"
    browser.wait_until(lambda: browser.evaluate(f"{there} && document.readyState == 'complete'"))


@pytest.mark.parametrize("name", PAGES)
def test_everybody_can_read_a_page_at_any_width_and_in_both_themes(browser, address, axe, name):
    for scheme in ("light", "dark"):
        browser.prefer(scheme)
        show(browser, f"{address}/{name}.html")
        assert browser.evaluate("document.documentElement.dataset.theme") == scheme
        assert browser.evaluate("document.querySelectorAll('h1').length") == 1
        for width in (1400, 420):
            browser.resize(width, 900)
            assert browser.overflow_px() == 0, (scheme, width)
            assert browser.evaluate(SIDEWAYS) == [], (scheme, width)
        # The theme lets a keyboard reach what scrolls a moment after the page got its size.
        browser.wait_until(lambda: browser.evaluate(REACHABLE))
        assert browser.inaccessible(axe) == [], scheme
        assert browser.complaints == []
        assert [url for url in browser.requests if not url.startswith((address, "data:"))] == []


def test_search_finds_a_page_without_a_network(browser, site):
    show(browser, (site / "search.html").as_uri() + "?q=sensitivities")

    found = "[...document.querySelectorAll('#search-results a')].map((a) => a.href)"
    browser.wait_until(lambda: any("method.html" in link for link in browser.evaluate(found)))

    assert browser.complaints == []
    assert all(url.startswith(("file:", "data:")) for url in browser.requests)


def test_formulas_are_drawn_without_a_script(browser, site):
    show(browser, (site / "method.html").as_uri())

    assert browser.evaluate("document.querySelectorAll('math').length") > 20
    assert browser.evaluate("document.querySelector('math').getBoundingClientRect().width") > 5


def test_a_link_to_nothing_fails_the_build(tmp_path):
    links = "\n\n".join(f"[{what}]({target})" for what, target in BROKEN.items())
    (tmp_path / "index.md").write_text(f"# Start\n\n{links}\n\n![picture](absent.png)\n")
    (tmp_path / "other.md").write_text("---\norphan: true\n---\n\n# Other\n")
    (tmp_path / "conf.py").write_text(
        f"import runpy\nglobals().update(runpy.run_path({str(ROOT / 'docs' / 'conf.py')!r}))\n"
        "navigation, html_static_path, html_css_files = {'index': ['not-there']}, [], []\n"
    )

    built = build(tmp_path, tmp_path / "out")

    assert built.returncode == 1
    for name in ("absent-page", "absent.py", "absent-folder", "absent-heading", "absent-there",
                 "absent.png", "not-there"):  # fmt: skip
        assert name in built.stderr
