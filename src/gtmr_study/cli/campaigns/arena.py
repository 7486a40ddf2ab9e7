# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command ``gtmr arena``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

from gtmr_study.cli.campaigns.campaign import (
    SchedulerOption,
    WorkersOption,
    reported_progress,
    require_one,
)
from gtmr_study.cli.tables import explains, new_table
from gtmr_study.cli.terminal import JsonOption, complain, console, option, require_seed
from gtmr_study.result_files import InputError, require_folder, require_folder_of, write_json

QUICK: dict[str, Any] = {"trials": 4, "d_ref_m": (0.25, 0.35), "duration_s": 10.0}
"""What is flown where only a quick look is wanted."""

COLUMNS = {
    "controller": "Who flies, from the one that flies closest to the tower on.",
    "from [m]": "The smallest d_ref that it really flies: no trial violates the clearance "
    "or is in error, and the mean d_T is within 20 mm of d_ref.",
    "least [m]": "Least clearance d_T of any plant step there; at the largest d_ref where it "
    "flies none.",
    "RMS [mm]": "Of d_T - d_ref there, after the first 5 s.",
    "u [Hz/s]": "Root mean square of the rotors' accelerations there.",
    "step [ms]": "Time that a controller step takes, median, with as many flights at once as "
    "there are workers.",
}
"""What the columns of the table are."""


@explains(COLUMNS)
def arena_command(
    out: Annotated[
        Path, option("DIR", "Folder of results: new, empty, or of the same arena to go on with.")
    ],
    controllers: Annotated[
        str | None,
        option("NAME|FILE.py:CLASS,...", "Who flies.", "every controller of the arena"),
    ] = None,
    worlds: Annotated[
        str | None, option("NAME|YAML,...", "Where: presets or files.", "paper,field,hard")
    ] = None,
    d_ref: Annotated[
        str | None,
        option(
            "M,...",
            "Distances of the helix from the tower's surface [m].",
            "0.21,0.25,0.30,0.35,0.40",
        ),
    ] = None,
    trials: Annotated[
        int | None,
        option("N", "Flights of 20 s a cell; fewer of controllers that are slow.", "200", min=1),
    ] = None,
    seed: Annotated[int, option("K", "Seed of the trials.", "0")] = 0,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="4 flights of 10 s a cell, at 0.25 and 0.35 m: a look."),
    ] = False,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    json: JsonOption = None,
) -> None:
    """Fly controllers of every family on the same flights: one table, one page, one figure."""
    require_one(workers, scheduler)
    require_seed(seed)
    require_folder("--out", out)
    require_folder_of("--json", json)
    # Only now, since the help needs none of it.
    from gtmr_study.arena.page import write_arena
    from gtmr_study.arena.plan import WORLDS, Arena, MetWorld, named_controllers
    from gtmr_study.arena.run import fly_arena

    names, own = named_controllers("--controllers", controllers)
    given = {"trials": trials, "d_ref_m": None if d_ref is None else _distances(d_ref)}
    plan = (QUICK if quick else {}) | {k: v for k, v in given.items() if v is not None}
    arena = Arena.parse(
        {
            "controllers": [*names, *(each.name for each in own)],
            "own": [each.fingerprint.model_dump() for each in own],
            "worlds": [
                MetWorld.named(world) for world in (worlds.split(",") if worlds else WORLDS)
            ],
            "seed": seed,
            **plan,
        },
        "arena",
    )
    with reported_progress() as show:
        fly_arena(arena, out, own, workers, scheduler, partial(show, "flights"))
        results = write_arena(out, own)
    for met in arena.worlds:
        _print_world(results, met.name)
    for result in results:
        if result["reason"]:
            where = f"{result['controller']} in {result['world']} at {result['d_ref_m']:g} m"
            complain(f"{where}: {result['reason']}")
    console.print(f"Results: {out}\nPage:    {out / 'arena.html'} (open it in a browser)")
    write_json(json, results)


def _distances(value: str) -> list[float]:
    try:
        return [float(each) for each in value.split(",")]
    except ValueError:
        raise InputError(f"--d-ref = {value}: expected distances as 0.25,0.30") from None


def _print_world(results: list[dict[str, Any]], world: str) -> None:
    """Print who flies how close in a world."""
    from gtmr_study.arena.table import closest

    table, found = new_table(*COLUMNS), closest(results, world)
    table.title, table.title_justify = Text(f"World {world}"), "left"
    table.columns[0].min_width = max(map(len, found))
    for controller, best in found.items():
        farthest = next(
            result
            for result in reversed(results)
            if (result["controller"], result["world"]) == (controller, world)
        )
        told = best or farthest
        rms_m = told["radial_rms_settled_m"]
        table.add_row(
            Text(controller),
            "none" if best is None else f"{best['d_ref_m']:.2f}",
            _number(told["min_clearance_m"], 3),
            _number(None if rms_m is None else 1e3 * rms_m, 1),
            _number(told["u_rms_hz_s"], 0),
            _number(told["step_ms"], 2),
        )
    console.print(table)


def _number(value: float | None, places: int) -> str:
    return "-" if value is None else f"{value:.{places}f}"
