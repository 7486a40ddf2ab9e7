# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The flights of each cell that came closest to the tower, and how to fly each again."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from gtmr_study.arena.plan import Arena, Cell
from gtmr_study.campaign.trial import FLOWN
from gtmr_study.own_controller import OwnController
from gtmr_study.scenario_file import ScenarioFile

LISTED = 3
"""So many flights of each cell are written."""
FOLDER = "worst"
"""Where, in the folder of the arena."""


@dataclass(frozen=True)
class WorstFlight:
    """A flight, its file, and the command that flies it again."""

    trial: int
    """Its number."""
    min_clearance_m: float
    """Least d_T of any plant step [m]."""
    file: str
    """From the folder of the arena on."""
    command: str
    """In the folder of the arena."""


def write_worst(
    arena: Arena, rows: pd.DataFrame, folder: Path, own: Sequence[OwnController]
) -> dict[Cell, list[WorstFlight]]:
    """Write what ``gtmr fly --scenario`` needs of the worst flights of every cell."""
    paths = {each.name: Path(each.path).resolve() for each in own}
    flown = rows[rows["status"] == FLOWN]
    found: dict[Cell, list[WorstFlight]] = {}
    for key, group in flown.groupby(["controller", "world", "d_ref_m"], sort=False):
        cell = Cell(*key)
        closest = group.sort_values(["min_clearance_any_time_m", "trial"]).head(LISTED)
        told = zip(closest["trial"], closest["min_clearance_any_time_m"], strict=True)
        found[cell] = []
        for trial, least_m in told:
            file = Path(FOLDER, cell.world, f"{cell.controller}-{cell.d_ref_m:g}-{trial}.yaml")
            _write(arena, cell, int(trial), float(least_m), folder / file)
            command = f"gtmr fly --scenario {shlex.quote(str(file))}"
            if cell.controller in paths:
                named = f"{paths[cell.controller]}:{cell.controller}"
                command += f" --controller {shlex.quote(named)}"
            found[cell].append(WorstFlight(int(trial), float(least_m), str(file), command))
    return found


def _write(arena: Arena, cell: Cell, trial: int, least_m: float, path: Path) -> None:
    study = arena.study(cell.world, cell.d_ref_m)
    path.parent.mkdir(parents=True, exist_ok=True)
    ScenarioFile(
        mode=cell.controller,
        duration_s=arena.duration_s,
        controller=study.controller,
        scenario=study.scenario(trial),
        min_clearance_m=least_m,
    ).write(path)
