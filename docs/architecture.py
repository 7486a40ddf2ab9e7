# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Draws docs/architecture.svg: the packages as layers, and which imports which.

Run `.venv/bin/python docs/architecture.py`; a test holds the picture to the imports.
"""

from __future__ import annotations

from pathlib import Path

import grimp

PICTURE = Path(__file__).with_suffix(".svg")
LAYERS = {
    "gtmr_study": "command line, campaigns, ROS demo",
    "gtmr_monitor": "statistics, bags, reports, its node",
    "gtmr_nmpc": "the controller and its node",
    "gtmr_sim": "plant, gusts, worlds, its node",
    "gtmr_guard": "the backup at the actuators",
    "gtmr_msgs_py": "the ROS contract: topics, messages",
    "gtmr_codegen": "C out of CasADi, compiled",
    "gtmr_model": "physics and geometry",
}
"""Packages from the top to the bottom, with what each does."""
WIDTH, ROW, BOX_WIDTH, BOX_HEIGHT, LANE = 420, 64, 268, 52, 20
STYLE = """
.ground { fill: #ffffff } .box { fill: #eef3f8; stroke: #3a6ea5 }
.name { font: 600 16px monospace; fill: #14202b } .job { font: 14px sans-serif; fill: #33424f }
.arrow { fill: none; stroke-width: 1.6; stroke: #4a5a68 } .head { fill: #4a5a68 }
.lane1 { stroke: #0072b2 } .lane2 { stroke: #a04000 } .lane3 { stroke: #00724f }
.lane4 { stroke: #8f4a75 } .lane5 { stroke: #6b5a00 }
@media (prefers-color-scheme: dark) {
  .ground { fill: #14181e } .box { fill: #22303f; stroke: #6fa3d8 }
  .name { fill: #f2f5f8 } .job { fill: #c9d3dc } .arrow { stroke: #a9b5c0 } .head { fill: #a9b5c0 }
  .lane1 { stroke: #56b4e9 } .lane2 { stroke: #f08a4b } .lane3 { stroke: #3fc79a }
  .lane4 { stroke: #e0a3c5 } .lane5 { stroke: #e0c94a }
}
"""


def imports() -> dict[str, list[str]]:
    """Find which other packages each package imports, those at the top first."""
    graph = grimp.build_graph(*LAYERS)
    return {
        importer: [
            name
            for name in LAYERS
            if name != importer
            and graph.direct_import_exists(importer=importer, imported=name, as_packages=True)
        ]
        for importer in LAYERS
    }


def picture() -> str:
    """Draw it, as SVG."""
    found = imports()
    height = ROW * len(LAYERS) + 8
    said = "; ".join(f"{name} imports {', '.join(found[name]) or 'no other'}" for name in LAYERS)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="560" '
        f'role="img" aria-label="{said}">',
        f"<style>{STYLE}</style>",
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" '
        'markerHeight="6" orient="auto"><path class="head" d="M0 0L8 4L0 8z"/></marker></defs>',
        f'<rect class="ground" width="{WIDTH}" height="{height}" rx="8"/>',
    ]
    importers = [name for name in LAYERS if found[name]]
    for lane, name in enumerate(importers):
        parts += [arrow(name, below, lane, len(importers)) for below in found[name]]
    for row, (name, job) in enumerate(LAYERS.items()):
        top, middle = 10 + ROW * row, 10 + BOX_WIDTH / 2
        parts += [
            f'<rect class="box" x="10" y="{top}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" '
            'rx="6"/>',
            f'<text class="name" x="{middle:g}" y="{top + 22}" text-anchor="middle">{name}</text>',
            f'<text class="job" x="{middle:g}" y="{top + 42}" text-anchor="middle">{job}</text>',
        ]
    return "\n".join([*parts, "</svg>\n"])


def arrow(importer: str, imported: str, lane: int, lanes: int) -> str:
    """Draw one import: out of the one box, down the importer's lane, into the other."""
    rows = list(LAYERS)
    edge = 10 + BOX_WIDTH
    x = WIDTH - 12 - LANE * lane
    start = 10 + ROW * rows.index(importer) + BOX_HEIGHT - 8
    # Inner lanes arrive lower, so that lines cross as little as can be.
    end = 10 + ROW * rows.index(imported) + 6 + (BOX_HEIGHT - 22) * lane / (lanes - 1)
    return (
        f'<path class="arrow lane{lane}" data-imports="{importer} {imported}" '
        f'd="M{edge} {start}H{x}V{end:g}H{edge + 1}" marker-end="url(#head)"/>'
    )


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
