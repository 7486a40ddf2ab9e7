# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What every report is made of: a page that loads nothing, its style sheet, and tables."""

from collections.abc import Sequence
from html import escape

_STYLE = """
:root { color-scheme: light; }
body {
  max-width: 1080px; margin: 2.5rem auto 5rem; padding: 0 1.25rem;
  font: 16px/1.5 system-ui, "Segoe UI", "Helvetica Neue", Arial, sans-serif;
  color: #1a1a1a; background: #fff;
}
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 1.5rem; }
h2 { font-size: 1.3rem; line-height: 1.3; margin: 2.75rem 0 0.5rem; }
p { max-width: 46rem; margin: 0.25rem 0 0.75rem; color: #444; }
figure { margin: 0; break-inside: avoid; }
figure svg { max-width: 100%; height: auto; }
.tables { display: flex; flex-wrap: wrap; column-gap: 5rem; }
.tables section { min-width: 0; }
.tables h2 { margin-top: 0.5rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 0.22rem 1.4rem 0.22rem 0; text-align: left; font-weight: 400; }
tbody tr { border-top: 1px solid #e3e3e3; }
tbody th { color: #444; padding-right: 1.8rem; }
thead th { font-weight: 600; white-space: nowrap; }
.wide th, .wide td { padding-right: 0.8rem; font-size: 0.9em; }
.wide thead th { white-space: normal; }
.key {
  display: inline-block; width: 0.8em; height: 0.8em; margin-right: 0.45em; border-radius: 2px;
}
.bad { color: #a33c00; }
.warning {
  padding: 0.6rem 0.9rem; border-left: 4px solid #d55e00; background: #fdf1ea; color: #1a1a1a;
}
@media print { body { margin: 0; max-width: none; } }
"""


def page(title: str, body: str, script: str = "") -> str:
    """Make a page that loads nothing, of a title in plain text and a body in HTML."""
    # The icon in the page keeps the browser from asking for one.
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<link rel="icon" href="data:,">
<style>{_STYLE}</style>
{f"<script>{script}</script>" if script else ""}
</head>
<body>
<h1>{escape(title)}</h1>
{body}
</body>
</html>
"""


def table(heads: Sequence[tuple[str, str]], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    """Make a table of rows, each a title and its cells in HTML.

    Each head is a column's title in plain text, and its colour, empty for none.
    """
    head = "".join(
        f'<th scope="col">{_key(colour)}{escape(title)}</th>' for title, colour in heads
    )
    head = f"<thead><tr><td></td>{head}</tr></thead>" if heads else ""
    body = "\n".join(
        f'<tr><th scope="row">{title}</th>' + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>"
        for title, row in rows
    )
    return f'<div class="scroll"><table>{head}<tbody>\n{body}\n</tbody></table></div>'


def _key(colour: str) -> str:
    return f'<span class="key" style="background:{colour}"></span>' if colour else ""


def signed(value: float) -> str:
    """Write a number to three places, with a true minus sign."""
    return f"{value:.3f}".replace("-", "−")
