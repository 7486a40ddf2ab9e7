# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The search: vertices, chance, and CMA-ES; resumable, and the same on any number of workers."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import cmaes
import numpy as np
from numpy.typing import NDArray

from gtmr_study.attack.space import (
    LENGTH,
    Target,
    fly_choices,
    random_choice,
    scenario_of,
    vertex_choice,
)
from gtmr_study.campaign import cluster
from gtmr_study.result_files import InputError, write_whole
from gtmr_study.scenario_file import ScenarioFile

Array = NDArray[np.float64]

GENERATION = 32
"""Flights that are chosen together."""
GENERATIONS = 40
"""Generations of one run of CMA-ES; the next one begins elsewhere."""
STRUCTURED = 4
"""One in so many flights is a vertex, one is by chance, the rest is CMA-ES."""
SIGMA = 0.2
"""Step with which CMA-ES begins, of the range of a number."""
KEPT = 10
"""How many of the worst flights are written as scenarios."""
CHUNK = 4
"""Flights handed out at a time."""
FLIGHTS = "flights.jsonl"
"""What was flown, a line each; the first line says what was searched."""

OnProgress = Callable[[int, int], None]
"""Told how many flights are done, and of how many."""


class Flown:
    """The file of flights: what is in it is not flown again.

    InputError if the folder holds the flights of another search, damaged ones, or anything else.
    """

    def __init__(self, folder: Path, target: Target, flights: int, seed: int) -> None:
        self.path = folder / FLIGHTS
        text = target.model_dump_json()
        # How many there are decides who chooses which.
        searched = hashlib.sha256(text.encode()).hexdigest()
        self._head = {"flights": flights, "seed": seed, "searched": searched}
        self.clearances_m: list[float] = []
        """Of the flights so far, by number [m]."""
        if folder.is_dir() and any(folder.iterdir()) and not self.path.exists():
            raise InputError(
                f"--out = {folder}: holds {next(folder.iterdir()).name} but no search; nothing "
                "was changed: give a new or empty folder"
            )
        folder.mkdir(parents=True, exist_ok=True)
        if self.path.exists():
            self._read(folder)
        else:
            write_whole(self.path, json.dumps(self._head) + "\n")

    def _read(self, folder: Path) -> None:
        # Of a line that was being written when its writer was killed there is no end.
        try:
            head, *rows = self.path.read_text(encoding="utf-8").split("\n")
            whole = rows[:-1]
            told = json.loads(head)
            found = [json.loads(row) for row in whole]
            numbers = [row["number"] for row in found]
            self.clearances_m = [float(row["min_clearance_m"]) for row in found]
        except (ValueError, KeyError, TypeError):
            numbers, told = [-1], None
        if told == self._head and numbers != list(range(len(numbers))):
            told = None
        if told is None:
            raise InputError(f"--out = {folder}: {FLIGHTS} is damaged; nothing was changed")
        if told != self._head:
            raise InputError(
                f"--out = {folder}: holds another search; nothing was changed: give another folder"
            )
        if rows[-1]:
            kept = "\n".join([head, *whole]) + "\n"
            write_whole(self.path, kept)

    def add(self, clearances_m: list[float]) -> None:
        """Keep the next flights."""
        with self.path.open("a", encoding="utf-8") as file:
            for value in clearances_m:
                number = len(self.clearances_m)
                row = {"number": number, "min_clearance_m": value}
                file.write(json.dumps(row) + "\n")
                self.clearances_m.append(value)


def attack(
    target: Target,
    flights: int,
    seed: int,
    folder: Path,
    n_workers: int | None = None,
    on_progress: OnProgress = lambda *_: None,
) -> dict[str, Any]:
    """Search for the least clearance, or go on with a search; a seed chooses the same flights.

    ``folder`` keeps every flight, and the worst as scenario files. Returns ``flights``,
    ``violations``, ``min_clearance_m`` and ``worst``, the scenarios from the worst on. InputError
    if the folder holds anything else than this search.
    """
    flown = Flown(folder, target, flights, seed)
    chosen: list[Array] = []
    with cluster.local_threads(n_workers) as workers:
        for generation, tell in _generations(flights, seed, flown.clearances_m, chosen):
            numbers = range(len(chosen) - len(generation), len(chosen))
            new = [n for n in numbers if n >= len(flown.clearances_m)]
            flown.add(_fly(workers, target, [(n, chosen[n]) for n in new], seed))
            tell([flown.clearances_m[n] for n in numbers])
            on_progress(len(chosen), flights)
    return _result(target, chosen, flown.clearances_m[: len(chosen)], seed, folder)


def _generations(
    flights: int, seed: int, found_m: list[float], chosen: list[Array]
) -> Iterator[tuple[list[Array], Callable[[list[float]], None]]]:
    """Choose a generation after the other; each is told what was found before the next."""
    share = flights // STRUCTURED

    def nothing(_: list[float]) -> None:
        return

    for kind in ("vertices", "chance"):
        for first in range(0, share, GENERATION):
            group = []
            for k in range(first, min(first + GENERATION, share)):
                rng = np.random.default_rng([seed, len(kind), k])
                if kind == "vertices":
                    # All vertices under one gust, then under the other, in an order of their own.
                    order = np.random.default_rng([seed, k // 1024]).permutation(1024)
                    vertex = int(order[k % 1024])
                    group.append(vertex_choice(vertex % 512, vertex >= 512, rng))
                else:
                    group.append(random_choice(rng))
            chosen.extend(group)
            yield group, nothing
    run = 0
    while len(chosen) < flights:
        yield from _evolution(flights, seed, run, found_m, chosen)
        run += 1


def _evolution(
    flights: int, seed: int, run: int, found_m: list[float], chosen: list[Array]
) -> Iterator[tuple[list[Array], Callable[[list[float]], None]]]:
    """One run of CMA-ES, from one of the worst flights so far."""
    order = np.argsort(found_m[: len(chosen)], kind="stable")
    start = chosen[int(order[run % min(KEPT, len(order))])] if len(order) else np.full(LENGTH, 0.5)
    search = cmaes.CMA(
        mean=np.clip(start, 0.0, 1.0),
        sigma=SIGMA,
        bounds=np.tile([0.0, 1.0], (LENGTH, 1)),
        seed=int(np.random.SeedSequence([seed, run]).generate_state(1)[0]),
        population_size=GENERATION,
    )
    for _ in range(GENERATIONS):
        size = min(GENERATION, flights - len(chosen))
        if size <= 0 or search.should_stop():
            return
        group = [search.ask() for _ in range(size)]
        chosen.extend(group)

        def tell(values: list[float], group: list[Array] = group) -> None:
            if len(group) == GENERATION:
                search.tell(list(zip(group, values, strict=True)))

        yield group, tell


def _fly(
    workers: Executor, target: Target, numbered: list[tuple[int, Array]], seed: int
) -> list[float]:
    chunks = [numbered[k : k + CHUNK] for k in range(0, len(numbered), CHUNK)]
    futures = [workers.submit(_fly_chunk, target, chunk, seed) for chunk in chunks]
    return [value for future in futures for value in future.result()]


def _fly_chunk(target: Target, numbered: list[tuple[int, Array]], seed: int) -> list[float]:
    seeds = [_noise_seed(seed, number) for number, _ in numbered]
    return fly_choices(target, [u for _, u in numbered], seeds)


def _noise_seed(seed: int, number: int) -> int:
    return int(np.random.SeedSequence([seed, 1, number]).generate_state(1)[0])


def _result(
    target: Target, chosen: list[Array], found_m: list[float], seed: int, folder: Path
) -> dict[str, Any]:
    d_min = target.controller.tower.min_clearance_m
    worst = []
    for place, number in enumerate(np.argsort(found_m, kind="stable")[:KEPT].tolist(), start=1):
        path = folder / f"worst-{place:02d}.yaml"
        scenario = scenario_of(target, chosen[number], _noise_seed(seed, number))
        ScenarioFile(
            mode=target.mode,
            duration_s=target.duration_s,
            controller=target.controller,
            scenario=scenario,
            min_clearance_m=found_m[number],
        ).write(path)
        worst.append({"scenario": str(path), "min_clearance_m": found_m[number]})
    return {
        "mode": target.mode,
        "flights": len(found_m),
        "violations": sum(value < d_min for value in found_m),
        "min_clearance_m": min(found_m),
        "worst": worst,
    }
