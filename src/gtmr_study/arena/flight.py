# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""One flight of the arena boiled down to a row; whatever a controller does, there is a row."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gtmr_sim import StepController, fly
from gtmr_study.arena.plan import Arena, Cell
from gtmr_study.campaign.trial import ERROR, FLOWN, Row, flight_figures
from gtmr_study.own_controller import OwnController
from gtmr_study.result_files import one_line
from gtmr_study.rivals.catalogue import RIVALS

STOPPED, LEFT_OUT = "stopped", "left out"
"""Further statuses of a row: its steps took too long; it was not flown since its cell's first
flight was stopped."""
FIGURES = (
    "min_clearance_any_time_m",
    "violated_any_time",
    "mean_clearance_m",
    "radial_rms_settled_m",
    "min_airframe_clearance_m",
    "failed_steps",
)
"""Columns that a campaign has as well."""
TIMES = ("steps", "step_ms_median", "step_ms_p99")
"""Columns of measured times, which no two runs have in common. Of a flight that was stopped
``steps`` is how many there were, and the median their mean."""
COLUMNS = (
    "controller",
    "world",
    "d_ref_m",
    "trial",
    "seed",
    "status",
    "error",
    *FIGURES,
    "u_rms_hz_s",
    *TIMES,
)
"""Columns of flights.csv."""

Own = Mapping[str, OwnController]
"""Controllers of one's own by their names."""
Chunk = tuple[Cell, Sequence[int]]
"""A cell and numbers of trials."""


class StoppedFlight(Exception):
    """Steps of a flight took too long."""


class _Clock:
    """Stops a flight whose steps take too long, counted from when it is first told of some."""

    def __init__(self, arena: Arena) -> None:
        self.arena = arena
        self.steps, self.mean_ms = 0, 0.0
        self._first: tuple[int, float] | None = None

    def __call__(self, steps: int) -> None:
        self.steps, now_s = steps, time.perf_counter()
        if self._first is None:
            self._first = steps, now_s
            return
        first, start_s = self._first
        self.mean_ms = 1e3 * (now_s - start_s) / (steps - first)
        budget_ms = self.arena.step_budget_ms
        if now_s - start_s > self.arena.patience_s and self.mean_ms > budget_ms:
            raise StoppedFlight(f"steps take more than the {budget_ms:g} ms that are allowed")


def fly_chunk(arena: Arena, chunk: Chunk, own: Own) -> list[Row]:
    """Fly some trials of a cell; this is what a worker runs."""
    cell, trials = chunk
    return [fly_one(arena, cell, trial, own) for trial in trials]


def fly_one(arena: Arena, cell: Cell, trial: int, own: Own) -> Row:
    """Fly one trial of a cell. The row says why if the controller raised or was too slow.

    The controller is made anew for every flight.
    """
    row, clock = empty_row(cell, trial), _Clock(arena)
    try:
        study = arena.study(cell.world, cell.d_ref_m)
        scenario = study.scenario(trial)
        row["seed"] = scenario.seed
        pilot: StepController
        if cell.controller in own:
            pilot = own[cell.controller].make(study.controller)
        else:
            pilot = RIVALS[cell.controller].make(study.controller, scenario)
        # What is lost goes far beyond what numbers hold; its row says so.
        with np.errstate(all="ignore"):
            log = fly(scenario, pilot, study.duration_s, study.controller.sampling_time_s, clock)
        flown = flight_figures(log)
        row.update(
            {name: flown[name] for name in FIGURES},
            status=FLOWN,
            u_rms_hz_s=round(float(np.sqrt(np.mean(log.u**2))), 4),
            steps=clock.steps,
            step_ms_median=flown["solve_ms_median"],
            step_ms_p99=flown["solve_ms_p99"],
        )
    except StoppedFlight as error:
        row.update(status=STOPPED, error=str(error), steps=clock.steps)
        row.update(step_ms_median=round(clock.mean_ms, 4))
    except Exception as error:
        # Whatever goes wrong in one of many flights belongs into its row.
        row.update(status=ERROR, error=one_line(error))
    return row


def left_out(cell: Cell, trial: int) -> Row:
    """Make the row of a flight that need not be flown: the first of its cell was stopped."""
    return empty_row(cell, trial) | {"status": LEFT_OUT, "error": "the cell's first was stopped"}


def empty_row(cell: Cell, trial: int) -> dict[str, Any]:
    """Make a row that says nothing yet but whose it is."""
    return {**dict.fromkeys(COLUMNS, ""), **cell._asdict(), "trial": trial}
