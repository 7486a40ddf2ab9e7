# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""An arena from start, or from where it was interrupted, to its rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pandas as pd

from gtmr_study.arena.flight import (
    COLUMNS,
    STOPPED,
    Chunk,
    Own,
    empty_row,
    fly_chunk,
    left_out,
)
from gtmr_study.arena.plan import Arena, Cell
from gtmr_study.campaign import cluster
from gtmr_study.campaign.trial import ERROR, Row
from gtmr_study.own_controller import OwnController
from gtmr_study.result_files import InputError, one_line
from gtmr_study.results_folder import Kind, RowsFile

ARENA = Kind("an arena", "plan", Arena)
FLIGHTS_FILE = "flights.csv"
LONGER = 4
"""By how much more flights are handed out at a time than in a campaign: what a worker works out
for a new cell, a controller's margins for example, must cost little beside them."""

OnProgress = Callable[[int, int], None]
"""Told how many flights are done, and of how many."""
Flight = tuple[str, str, float, int]
"""A cell and a trial: what names a row."""


def fly_arena(
    arena: Arena,
    folder: Path,
    own: Sequence[OwnController] = (),
    n_workers: int | None = None,
    scheduler: str | None = None,
    on_progress: OnProgress = lambda *_: None,
) -> pd.DataFrame:
    """Fly what is missing of an arena; give the rows, columns as `flight.COLUMNS`.

    The folder is new, empty, or holds a part of the same arena; rows are there as soon as their
    flights are done, and for any number of workers they differ in measured times only. Workers and
    errors are those of `cluster.workers`; InputError as well if the folder holds anything else or
    an own controller cannot be made, ResultsError if rows cannot be written; finished flights are
    kept.
    """
    by_name = {each.name: each for each in own}
    # Whatever is wrong with distances or an own class is bad input: nothing is written yet.
    for met in arena.worlds:
        for d_ref_m in arena.d_ref_m:
            study = arena.study(met.name, d_ref_m)
            for each in own:
                each.make(study.controller)
    with ExitStack() as stack:
        ARENA.require_own_or_empty("--out", folder, arena)
        executor = None
        if scheduler is not None:
            # Before anything is written: a wrong address leaves no folder behind.
            executor = stack.enter_context(cluster.remote_workers(scheduler))
        stack.enter_context(ARENA.opened("--out", folder, arena))
        file = RowsFile(folder / FLIGHTS_FILE, COLUMNS, _named, ARENA.what)
        total = sum(arena.trials_of(cell.controller) for cell in arena.cells())
        on_progress(len(file.done), total)
        if len(file.done) < total:
            if executor is None:
                executor = stack.enter_context(cluster.local_workers(n_workers))
            for rows in _fly(executor, arena, file, by_name):
                file.append(rows)
                on_progress(len(file.done), total)
        order = {(*cell, trial): k for k, (cell, trial) in enumerate(_flights(arena))}
        file.sort(order.__getitem__)
    return read_flights(folder)


def read_flights(folder: Path) -> pd.DataFrame:
    """Read the rows of an arena; InputError if there are none."""
    path = folder / FLIGHTS_FILE
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    if tuple(table.columns) != COLUMNS:
        raise InputError(f"{path}: does not have the columns of {ARENA.what}")
    return table


def _named(row: Sequence[str]) -> Flight:
    controller, world, d_ref_m, trial, *_ = row
    return controller, world, float(d_ref_m), int(trial)


def _flights(arena: Arena) -> Iterator[tuple[Cell, int]]:
    for cell in arena.cells():
        for trial in range(arena.trials_of(cell.controller)):
            yield cell, trial


def _fly(executor: Executor, arena: Arena, file: RowsFile, own: Own) -> Iterator[list[Row]]:
    """Fly the first trial of every cell, then the rest of those that were not stopped."""
    firsts: list[Chunk] = [(cell, [0]) for cell in arena.cells() if (*cell, 0) not in file.done]
    yield from _on_workers(executor, arena, firsts, own)
    stopped = {
        Cell(row["controller"], row["world"], float(row["d_ref_m"]))
        for row in file.rows()
        if row["status"] == STOPPED and row["trial"] == "0"
    }
    chunks: list[Chunk] = []
    for cell in arena.cells():
        trials = range(1, arena.trials_of(cell.controller))
        missing = [trial for trial in trials if (*cell, trial) not in file.done]
        if cell in stopped:
            yield [left_out(cell, trial) for trial in missing]
            continue
        share = arena.trials_of(cell.controller) / arena.trials
        size = max(1, round(LONGER * share * cluster.chunk_size(arena.duration_s)))
        pieces = (missing[first : first + size] for first in range(0, len(missing), size))
        chunks += [(cell, piece) for piece in pieces]
    # All cells grow alike, so that what was cut short tells of all of them.
    chunks.sort(key=lambda chunk: chunk[1][0])
    yield from _on_workers(executor, arena, chunks, own)


def _on_workers(
    executor: Executor, arena: Arena, chunks: Sequence[Chunk], own: Own
) -> Iterator[list[Row]]:
    for (cell, trials), rows in cluster.run_chunks(
        executor, partial(fly_chunk, own=own), arena, chunks
    ):
        if isinstance(rows, BaseException):
            # Flights report their own errors; here the workers themselves gave up.
            lost = {"status": ERROR, "error": one_line(rows)}
            yield [empty_row(cell, trial) | lost for trial in trials]
        else:
            yield rows
