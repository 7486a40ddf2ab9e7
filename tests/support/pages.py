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

WIDTHS_PX = (1400, 420)

needs_chromium = pytest.mark.skipif(chromium.find() is None, reason="no Chromium here")


def opened(html: Path) -> chromium.Page:
    """Open a page in a browser."""
    return chromium.Page(html.resolve().as_uri(), 1400, 1000)


def wait_until_drawn(page: chromium.Page) -> None:
    """Wait until a page has drawn its charts."""
    page.wait_until(lambda: page.evaluate("document.documentElement.dataset.drawnMs") is not None)


def require_for_everybody(page: chromium.Page, axe: str) -> None:
    """Check a page that is drawn: asks for nothing, complains of nothing, fits, is accessible."""
    for theme in ("light", "dark"):
        page.prefer(theme)
        for width in WIDTHS_PX:
            page.resize(width, 1000)
            page.wait_until(lambda: page.overflow_px() == 0, 15.0)
            assert page.inaccessible(axe) == [], f"{theme}, {width} px"
    assert page.evaluate("document.querySelectorAll('h1').length") == 1
    loaded = [url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))]
    assert (loaded, page.complaints) == ([], [])
