# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""What every page has to be: self-contained, and readable for everybody on every screen."""

from __future__ import annotations

from pathlib import Path

import pytest

from support import chromium

WIDTHS_PX = {"light": (420, 1400), "dark": (1400, 420)}
"""In which order each theme is looked at; at the last width by axe-core, which takes seconds."""

needs_chromium = pytest.mark.skipif(chromium.find() is None, reason="no Chromium here")


# Charts that are not as wide as their place, or have no height.
_ILL_FITTING = """[...document.querySelectorAll('.chart')].filter((div) => {
  const drawn = div.querySelector('.main-svg').getBoundingClientRect();
  return Math.abs(drawn.width - div.clientWidth) > 1 || drawn.height < 200
    || Math.abs(drawn.height - div.clientHeight) > 1;
}).length"""


def opened(html: Path) -> chromium.Page:
    """Open a page in a browser."""
    return chromium.Page(html.resolve().as_uri(), 1400, 1000)


def wait_until_drawn(page: chromium.Page) -> None:
    """Wait until a page has drawn its charts."""
    page.wait_until(lambda: page.evaluate("document.documentElement.dataset.drawnMs") is not None)


def require_for_everybody(page: chromium.Page, axe: str) -> None:
    """Check a page that is drawn: asks for nothing, complains of nothing, fits, is accessible."""
    for theme, widths in WIDTHS_PX.items():
        page.prefer(theme)
        for width in widths:
            page.resize(width, 1000)
            page.wait_until(lambda: page.overflow_px() == 0 and not page.evaluate(_ILL_FITTING))
        assert page.inaccessible(axe) == [], theme
    assert page.evaluate("document.querySelectorAll('h1').length") == 1
    loaded = [url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))]
    assert (loaded, page.complaints) == ([], [])
