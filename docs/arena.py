# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Put what an arena found into docs/arena.md: `python docs/arena.py [FOLDER]`.

The folder is one of ``gtmr arena``. Its results, plan and figure are kept in docs/arena, from
which the page is made again without a folder; what it says of families is in their modules.
"""

from __future__ import annotations

import ast
import json
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gtmr_study.arena.charts import FIGURE
from gtmr_study.arena.page import RESULTS
from gtmr_study.arena.plan import Arena
from gtmr_study.arena.run import ARENA
from gtmr_study.arena.table import Result, candidates, closest, is_flown
from gtmr_study.rivals.catalogue import RIVALS

PAGE = Path(__file__).with_suffix(".md")
KEPT = PAGE.parent / "arena"
FILES = (RESULTS, ARENA.file, f"{FIGURE}.png")
MODULES = PAGE.parents[1] / "src" / "gtmr_study" / "rivals"
Row = list[str]


def table(titles: Row, rows: list[Row]) -> str:
    """Write a table in Markdown."""
    lines = [titles, ["---"] * len(titles), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def conditions(arena: Arena) -> str:
    """Say what was flown, and the command that flies it again."""
    controllers, worlds = ",".join(arena.controllers), ",".join(met.name for met in arena.worlds)
    distances = ",".join(f"{d:g}" for d in arena.d_ref_m)
    fewer = [name for name in arena.controllers if arena.trials_of(name) < arena.trials]
    less = "; ".join(f"{arena.trials_of(name)} of `{name}`" for name in fewer)
    return (
        f"{len(arena.controllers)} controllers, {len(arena.worlds)} worlds, "
        f"{len(arena.d_ref_m)} distances, {arena.trials} trials of {arena.duration_s:g} s in each "
        f"point{f' ({less}, whose steps take long)' if less else ''}, seed {arena.seed}:\n\n"
        f"```bash\ngtmr arena --controllers {controllers} \\\n    --worlds {worlds} --d-ref "
        f"{distances} --trials {arena.trials} --seed {arena.seed} --out DIR\n```\n"
    )


def choices(arena: Arena, results: list[Result]) -> str:
    """Say whom to take in each world, and why."""
    rows = []
    for met in arena.worlds:
        best, *next_ones = candidates(results, met.name) or [None]
        if best is None:
            rows.append([f"`{met.name}`", "nobody", "", "", "", "", "", ""])
            continue
        others = [f"`{other['controller']}` from {other['d_ref_m']:.2f} m" for other in next_ones]
        rows.append(
            [
                f"`{met.name}`",
                f"**`{best['controller']}`**",
                f"{best['d_ref_m']:.2f} m",
                f"0 of {best['trials']}, below {100.0 * best['violations_95'][1]:.1f} %",
                f"{number(best['min_clearance_m'], 3)} m",
                f"{number(best['radial_rms_settled_m'], 1, 1e3)} mm",
                f"{number(best['step_ms'], 2)} ms",
                ", ".join(others[:2]) or "nobody",
            ]
        )
    titles = ["world", "take", "from d_ref", "violations", "least d_T", "RMS", "step", "next"]
    return table(titles, rows)


def distances(arena: Arena, results: list[Result]) -> str:
    """Say of each controller in each world which distances it flies, and how."""
    parts = []
    for met in arena.worlds:
        here = [result for result in results if result["world"] == met.name]
        rows = []
        for name, best in closest(results, met.name).items():
            own = [result for result in here if result["controller"] == name]
            told = best or own[-1]
            rows.append(
                [
                    f"`{name}`",
                    "none" if best is None else f"**{best['d_ref_m']:.2f} m**",
                    *map(standing, own),
                    number(told["radial_rms_settled_m"], 1, 1e3),
                    number(told["u_rms_hz_s"], 0),
                    number(told["step_ms"], 2),
                ]
            )
        titles = ["controller", "flies from", *(f"{d:.2f} m" for d in arena.d_ref_m)]
        titles += ["RMS [mm]", "effort [Hz/s]", "step [ms]"]
        parts.append(f"### World {met.name}\n\n{table(titles, rows)}")
    return "\n".join(parts)


def standing(result: Result) -> str:
    """Say in a few words how a cell stands."""
    if result["errors"]:
        return f"{result['errors']} in error"
    if result["missing"]:
        return f"{result['missing']} missing"
    if result["violations"]:
        return f"{result['violations']} of {result['trials']} violate"
    if is_flown(result):
        return f"{number(result['min_clearance_m'], 3)}"
    return f"mean {number(result['mean_clearance_m'], 2)}"


def reasons(_: Arena, results: list[Result]) -> str:
    """List what ended in an error."""
    failed = [result for result in results if result["reason"]]
    if not failed:
        return "No flight ended in an error, or was stopped.\n"
    rows = [
        [f"`{r['controller']}`", r["world"], f"{r['d_ref_m']:.2f} m", r["reason"]] for r in failed
    ]
    return table(["controller", "world", "d_ref", "why"], rows)


def families(*_: Any) -> str:
    """Take over what the modules of rivals say of themselves."""
    modules = {path.stem: path for path in sorted(MODULES.rglob("*.py"))}
    parts = []
    # One that does not fly says why.
    for name in (name for name in (*RIVALS, "min_max") if name in modules):
        text = ast.get_docstring(ast.parse(modules[name].read_text(encoding="utf-8"))) or ""
        first, _, rest = text.partition("\n\n")
        place = modules[name].relative_to(PAGE.parents[1])
        parts.append(f"### {name}\n\n{prose(first)} [Source](../{place}).\n\n{prose(rest)}\n")
    return "\n".join(parts) or "Their modules say nothing yet.\n"


def prose(text: str) -> str:
    """Make Markdown of a docstring: code in single quotes, signs that mean something kept."""
    parts = re.split(r"(``.+?``|`.+?`)", text)
    return "".join(
        f"`{part.strip('`')}`" if part.startswith("`") else re.sub(r"([*<$_\[\]])", r"\\\1", part)
        for part in parts
    )


def number(value: float | None, places: int, scale: float = 1.0) -> str:
    """Write a number, or that there is none."""
    return "–" if value is None else f"{scale * value:.{places}f}"


PARTS: dict[str, Callable[[Arena, list[Result]], str]] = {
    "conditions": lambda arena, _: conditions(arena),
    "choices": choices,
    "distances": distances,
    "reasons": reasons,
    "families": families,
}
"""What is written between which markers."""


def page(text: str) -> str:
    """Put what is kept between its markers."""
    arena = ARENA.read(KEPT)
    results = json.loads((KEPT / RESULTS).read_text(encoding="utf-8"))
    for name, written in PARTS.items():
        pattern = re.compile(f"<!-- {name} -->\n.*?<!-- end -->", re.DOTALL)
        whole = f"<!-- {name} -->\n\n{written(arena, results)}\n<!-- end -->"
        text, found = pattern.subn(lambda _, whole=whole: whole, text)
        if found != 1:
            raise SystemExit(f"{PAGE}: {found} places for {name}")
    return text


def main() -> None:
    """Keep what a folder says, and write the page."""
    for folder in map(Path, sys.argv[1:]):
        if any(result["missing"] for result in json.loads((folder / RESULTS).read_text())):
            raise SystemExit(f"{folder}: flights are still missing; the same command goes on")
        KEPT.mkdir(exist_ok=True)
        for name in FILES:
            shutil.copy(folder / name, KEPT / name)
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
