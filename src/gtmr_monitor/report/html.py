# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What every report is made of: a page that loads nothing, its style sheet, and tables."""

import base64
import gzip
from collections.abc import Iterable, Sequence
from functools import cache
from html import escape
from importlib.resources import files
from typing import NamedTuple

from plotly.offline import get_plotlyjs

from gtmr_monitor.report.look import PALETTE, themed

GOOD, BAD = "✓", "✗"
"""Signs beside the colours of what is well and what is not, which not everybody tells apart."""


class Card(NamedTuple):
    """A figure that is seen first."""

    title: str
    """What it is of, in plain text."""
    value: str
    """The figure, in HTML."""
    text: str
    """What it means, in HTML."""
    key: str = "grid"
    """Colour of its edge in the palette."""


def page(title: str, body: str, charts: bool = False) -> str:
    """Make a page that loads nothing, of a title in plain text and a body in HTML.

    ``charts`` says whether the body has some, which plotly draws.
    """
    script = f"""<script type="text/plain" id="plotly">{_plotly()}</script>
<script>{_own("page.js")}</script>
"""
    # The icon in the page keeps the browser from asking for one.
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{escape(title)}</title>
<link rel="icon" href="data:,">
<style>
{_themes()}{_own("page.css")}</style>
</head>
<body>
<main>
<h1>{escape(title)}</h1>
{body}
</main>
{script if charts else ""}</body>
</html>
"""


@cache
def _plotly() -> str:
    """Read plotly's source, packed to less than half of its size."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode()


def _own(name: str) -> str:
    return files("gtmr_monitor.report").joinpath(name).read_text(encoding="utf-8")


def _themes() -> str:
    """Write the palette as CSS variables; the browser says which theme its user wants."""
    light, dark = (
        "".join(f" --{name}: {pair[theme]};" for name, pair in PALETTE.items()) for theme in (0, 1)
    )
    return (
        f":root {{ color-scheme: light dark;{light} }}\n"
        f"@media (prefers-color-scheme: dark) {{ :root {{{dark} }} }}\n"
        # On paper there is no dark page.
        f"@media print {{ :root {{{light} }} }}\n"
    )


def cards(shown: Iterable[Card]) -> str:
    """Put the figures that matter most beside each other."""
    items = "\n".join(
        f'<li style="border-color: {themed(card.key)}">{escape(card.title)}<b>{card.value}</b>'
        f"<small>{card.text}</small></li>"
        for card in shown
    )
    return f'<ul class="cards">\n{items}\n</ul>'


def verdict(good: bool, text: str) -> str:
    """Write words, in HTML, in the colour and with the sign of what is well or is not."""
    kind, sign = ("good", GOOD) if good else ("bad", BAD)
    return f'<span class="verdict {kind}">{sign} {text}</span>'


def table(heads: Sequence[tuple[str, str]], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    """Make a table of rows, each a title and its cells in HTML.

    Each head is a column's title in plain text, and its colour, empty for none.
    """
    head = "".join(f'<th scope="col">{key(colour)}{escape(title)}</th>' for title, colour in heads)
    head = f"<thead><tr><td></td>{head}</tr></thead>" if heads else ""
    body = "\n".join(
        f'<tr><th scope="row">{title}</th>' + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>"
        for title, row in rows
    )
    # Reached by the keyboard too, so that it can be scrolled.
    return f'<div class="scroll" tabindex="0"><table>{head}<tbody>\n{body}\n</tbody></table></div>'


def key(colour: str) -> str:
    """Put the patch of a colour in front of its name; nothing for none."""
    return f'<span class="key" style="background:{colour}"></span>' if colour else ""


def signed(value: float) -> str:
    """Write a number to three places, with a true minus sign."""
    return f"{value:.3f}".replace("-", "−")
