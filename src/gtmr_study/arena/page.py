# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The page of an arena: one HTML file that needs nothing else, arena.json and the figure."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import pandas as pd

from gtmr_monitor.report.charts import charts_html
from gtmr_monitor.report.html import Card, cards, page, table, verdict
from gtmr_monitor.report.look import controller_key, themed
from gtmr_study.arena.charts import SIGNS, in_browser, name_of, trials_in_browser, write_figure
from gtmr_study.arena.plan import Arena, Cell
from gtmr_study.arena.run import ARENA, read_flights
from gtmr_study.arena.table import (
    ENOUGH_TRIALS,
    Result,
    candidates,
    closest,
    is_flown,
    results_of,
)
from gtmr_study.arena.worst import WorstFlight, write_worst
from gtmr_study.campaign.trial import FLOWN
from gtmr_study.own_controller import OwnController
from gtmr_study.result_files import write_json, write_whole

PAGE, RESULTS = "arena.html", "arena.json"
Worst = dict[Cell, list[WorstFlight]]


def write_arena(folder: Path, own: Sequence[OwnController] = ()) -> list[Result]:
    """Write what the flights in a folder say: results, figure, page, and the worst of each cell.

    Gives the content of arena.json.
    """
    arena, rows = ARENA.read(folder), read_flights(folder)
    results = results_of(arena, rows)
    write_json(folder / RESULTS, results)
    write_figure(results, _d_min_m(arena), folder)
    worst = write_worst(arena, rows, folder, own)
    write_whole(folder / PAGE, page("Arena", _body(arena, results, rows, worst), charts=True))
    return results


def _d_min_m(arena: Arena) -> float:
    study = arena.study(arena.worlds[0].name, arena.d_ref_m[0])
    return study.controller.tower.min_clearance_m


def _body(arena: Arena, results: list[Result], rows: pd.DataFrame, worst: Worst) -> str:
    worlds = [met.name for met in arena.worlds]
    script = files("gtmr_study.arena").joinpath("arena.js").read_text(encoding="utf-8")
    trials = [_trials(results, rows, worst, world) for world in worlds]
    data = json.dumps(trials, separators=(",", ":")).replace("<", r"\u003c")
    signs = "; ".join(f"{sign.shape}: {sign.says}" for sign in SIGNS.values())
    return f"""<p>{_conditions(arena)}</p>
{cards(_card(results, world) for world in worlds)}
<p>A controller really flies a distance d<sub>ref</sub> if none of its trials violates the
clearance at any step of the plant or is in error, and its mean d<sub>T</sub> is within 20&nbsp;mm
of d<sub>ref</sub>. The smallest such distance decides, then the tracking error; who flew too few
trials to tell, fewer than {ENOUGH_TRIALS} where others flew more, is not taken. In the charts up
is safe and left is precise; each curve is one controller from the closest reference to the
farthest one. Signs: {escape(signs)}.</p>
{"".join(_section(arena, results, k, worst) for k in range(len(worlds)))}
<h2>Controllers</h2>
{table([], [(escape(name), [escape(arena.family_of(name))]) for name in arena.controllers])}
<script type="application/json" id="arena-trials">{data}</script>
<script>{script}</script>"""


def _conditions(arena: Arena) -> str:
    fewer = {c: n for c in arena.controllers if (n := arena.trials_of(c)) < arena.trials}
    less = ", ".join(f"{n} of {escape(c)}" for c, n in fewer.items())
    return (
        f"{len(arena.controllers)} controllers, {arena.trials} trials of "
        f"{arena.duration_s:g}&nbsp;s in each point{f' ({less})' if less else ''}, seed "
        f"{arena.seed}. Every controller meets the same mismatches, gusts and noise. The guard is "
        "off: past the end of a plan the rotors hold their speeds."
    )


def _card(results: list[Result], world: str) -> Card:
    taken = candidates(results, world)
    if not taken:
        return Card(f"World {world}", "nobody", verdict(False, "none really flies any distance"))
    best, *next_ones = taken
    others = [
        f"{escape(other['controller'])} from {other['d_ref_m']:.2f}&nbsp;m" for other in next_ones
    ]
    high = 100.0 * best["violations_95"][1]
    said = f"0 of {best['trials']} violate"
    return Card(
        f"World {world}: take",
        f"{escape(best['controller'])} at {best['d_ref_m']:.2f} m",
        f"{verdict(True, said)} (below {high:.1f}&nbsp;% with 95&nbsp;% confidence); mean "
        f"d<sub>T</sub> {best['mean_clearance_m']:.3f}&nbsp;m, RMS "
        f"{_number(best['radial_rms_settled_m'], 1, 1e3)}&nbsp;mm, {best['step_ms']:.2f}&nbsp;ms "
        f"a step. Next: {', '.join(others[:2]) or 'nobody'}.",
        controller_key(best["controller"]),
    )


def _section(arena: Arena, results: list[Result], number: int, worst: Worst) -> str:
    """Describe a world; its number is in the ids of what the page's script changes."""
    world = arena.worlds[number].name
    here = [result for result in results if result["world"] == world]
    d_min_m = _d_min_m(arena)
    charts = [in_browser(results, world, d_min_m), trials_in_browser(world, d_min_m)]
    options = "".join(f"<option>{escape(name_of(each))}</option>" for each in here)
    return f"""<h2>World {escape(world)}</h2>
<p>Point at a point to see its trials, or choose
<label>one: <select id="cell-{number}">{options}</select></label></p>
{charts_html(f"world-{number}", charts)}
<p>Its flights that came closest, and what flies them again in the folder of this page:</p>
<div class="scroll" tabindex="0"><ul id="worst-{number}"></ul></div>
<h3>Who flies how close</h3>
{_closeness(results, world)}
<details><summary>All points of this world</summary>
{_all(here, worst)}
</details>
"""


def _closeness(results: list[Result], world: str) -> str:
    """Table of who flies which distance."""
    here = [result for result in results if result["world"] == world]
    distances = sorted({result["d_ref_m"] for result in here})
    heads = [("really flies from", ""), *((f"{d:.2f} m", "") for d in distances)]
    rows = []
    for name, best in closest(results, world).items():
        own = {result["d_ref_m"]: result for result in here if result["controller"] == name}
        from_m = "none" if best is None else f"<strong>{best['d_ref_m']:.2f} m</strong>"
        key = f'<span class="key" style="background:{themed(controller_key(name))}"></span>'
        rows.append((f"{key}{escape(name)}", [from_m, *(_stands(own[d]) for d in distances)]))
    return table(heads, rows)


def _stands(result: Result) -> str:
    if result["errors"]:
        return verdict(False, f"{result['errors']} in error")
    if result["missing"]:
        return f"{result['missing']} missing"
    if result["violations"]:
        return verdict(False, f"{result['violations']} of {result['trials']}")
    if is_flown(result):
        return verdict(True, f"0 of {result['trials']}")
    return f"mean {result['mean_clearance_m']:.2f} m"


def _all(here: list[Result], worst: Worst) -> str:
    """Table of every cell of a world, with its worst flight."""
    titles = (
        "violations", "95 % interval", "least d_T [m]", "mean d_T [m]", "RMS [mm]",
        "effort [Hz/s]", "step [ms]", "closest flight", "errors",
    )  # fmt: skip
    rows = []
    for result in here:
        low, high = (100.0 * bound for bound in result["violations_95"])
        flights = worst.get(Cell(result["controller"], result["world"], result["d_ref_m"]), [])
        again = ", ".join(
            f'<a href="{escape(flight.file)}">trial {flight.trial}</a>' for flight in flights[:1]
        )
        cells = [
            verdict(not result["violations"], f"{result['violations']} of {result['trials']}")
            if result["trials"]
            else "none flown",
            f"{low:.1f} to {high:.1f} %",
            _number(result["min_clearance_m"], 3),
            _number(result["mean_clearance_m"], 3),
            _number(result["radial_rms_settled_m"], 1, 1e3),
            _number(result["u_rms_hz_s"], 0),
            _number(result["step_ms"], 2),
            again,
            escape(result["reason"]),
        ]
        rows.append((escape(name_of(result)), cells))
    return table([(title, "") for title in titles], rows)


def _number(value: float | None, places: int, scale: float = 1.0) -> str:
    return "–" if value is None else f"{scale * value:.{places}f}".replace("-", "−")


def _trials(results: list[Result], rows: pd.DataFrame, worst: Worst, world: str) -> dict[str, Any]:
    """Give the page's script what it shows of a world's cells."""
    flown = rows[(rows["status"] == FLOWN) & (rows["world"] == world)]
    by_cell = dict(iter(flown.groupby(["controller", "d_ref_m"], sort=False)))
    cells = {}
    for result in results:
        group = by_cell.get((result["controller"], result["d_ref_m"]))
        if result["world"] != world or group is None:
            continue
        cell = Cell(result["controller"], world, result["d_ref_m"])
        rms_mm = 1e3 * group["radial_rms_settled_m"].astype(float)
        cells[name_of(result)] = {
            "colour": themed(controller_key(result["controller"])),
            "trial": group["trial"].tolist(),
            "least_m": group["min_clearance_any_time_m"].astype(float).round(4).tolist(),
            "rms_mm": [None if pd.isna(value) else round(value, 2) for value in rms_mm],
            "worst": [
                {"trial": f.trial, "least_m": f.min_clearance_m, "file": f.file,
                 "command": f.command}
                for f in worst[cell]
            ],
        }  # fmt: skip
    taken = candidates(results, world)
    first = name_of(taken[0]) if taken else next(iter(cells), "")
    return {"cells": cells, "first": first}
