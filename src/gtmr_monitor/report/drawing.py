# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How figures on paper look: matplotlib without global state; as PNG, PDF and inline SVG."""

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gtmr_monitor.report import look

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.edgecolor": look.QUIET,
    "axes.labelcolor": look.INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": look.GRID,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "xtick.color": look.INK,
    "ytick.color": look.INK,
    # The same drawing gives the same file.
    "svg.hashsalt": "gtmr",
    "pdf.fonttype": 42,
}
_DPI = 160
_NO_DATE: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Producer": None, "Creator": None},
    "svg": {"Date": None},
}

Draw = Callable[[], Figure]


def new_figure(width_in: float, height_in: float) -> Figure:
    """Make an empty figure of that size [in]."""
    # Not through pyplot: no global state, no window system.
    figure = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save(draw: Draw, stem: Path, formats: Sequence[str] = ("png", "pdf")) -> list[Path]:
    """Draw a figure into a file of each format; the stem is the path without the ending."""
    paths = [stem.with_name(f"{stem.name}.{ending}") for ending in formats]
    with rc_context(_STYLE):
        figure = draw()
        for path, ending in zip(paths, formats, strict=True):
            figure.savefig(path, dpi=_DPI, metadata=_NO_DATE[ending])
    return paths


def inline_svg(draw: Draw) -> str:
    """Draw a figure as an svg element of an HTML page."""
    buffer = io.StringIO()
    with rc_context(_STYLE):
        draw().savefig(buffer, format="svg", metadata=_NO_DATE["svg"])
    text = buffer.getvalue()
    return text[text.index("<svg") :]
