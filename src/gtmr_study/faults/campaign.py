# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Trying faults, many at a time, counting what was kept, and the table of it."""

import multiprocessing
import os
import signal
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

from gtmr_study.campaign.summary import wilson_interval
from gtmr_study.faults.fault import Fault, Outcome

CHUNK = 10
"""How many tries are handed out at a time."""

Catalogue = Callable[[], dict[str, Fault]]
"""Gives the faults by name; a function of a module, so that a worker process finds it too."""
OnProgress = Callable[[str, int], None]
"""Told the name of a fault and how many of its tries are done."""


def try_faults(
    catalogue: Catalogue,
    names: Sequence[str],
    quick: bool,
    on_progress: OnProgress = lambda *_: None,
) -> list[dict[str, Any]]:
    """Try faults by name, each as often as it says, and give a row of results for each.

    The tries are the same whatever the number of processors. Those between real nodes come last,
    one by one: they need the machine for themselves. A row has ``fault``, ``promise``, ``place``,
    ``always``, ``tried``, ``held``, ``held_95`` (Wilson interval of the share held),
    ``worst_clearance_m``, ``recovery_s`` (the longest), both None where there is none, and
    ``why``, how often which reason was given.
    """
    faults = catalogue()
    tries = {name: faults[name].quick if quick else faults[name].tries for name in names}
    outcomes: dict[str, dict[int, Outcome]] = {name: {} for name in names}
    aside = [name for name in names if faults[name].place != "nodes"]
    chunks = [
        (name, range(start, min(start + CHUNK, tries[name])))
        for name in aside
        for start in range(0, tries[name], CHUNK)
    ]
    for name, numbers, found in _in_workers(catalogue, chunks):
        outcomes[name].update(zip(numbers, found, strict=True))
        on_progress(name, len(outcomes[name]))
    for name in names:
        if faults[name].place == "nodes":
            for k, outcome in enumerate(faults[name].outcomes(range(tries[name]))):
                outcomes[name][k] = outcome
                on_progress(name, len(outcomes[name]))
    return [
        _row(faults[name], [outcomes[name][k] for k in sorted(outcomes[name])]) for name in names
    ]


def _in_workers(
    catalogue: Catalogue, chunks: Sequence[tuple[str, range]]
) -> Iterator[tuple[str, range, list[Outcome]]]:
    if not chunks:
        return
    with ProcessPoolExecutor(
        max_workers=min(len(os.sched_getaffinity(0)), len(chunks)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_leave_interrupts_to_parent,
    ) as pool:
        futures = {pool.submit(_try, catalogue, *chunk): chunk for chunk in chunks}
        try:
            for future in as_completed(futures):
                yield *futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _leave_interrupts_to_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _try(catalogue: Catalogue, name: str, tries: range) -> list[Outcome]:
    return list(catalogue()[name].outcomes(tries))


def _row(fault: Fault, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    held = sum(outcome.held for outcome in outcomes)
    clearances = [o.clearance_m for o in outcomes if o.clearance_m is not None]
    recoveries = [o.recovery_s for o in outcomes if o.recovery_s is not None]
    return {
        "fault": fault.name,
        "promise": fault.promise,
        "place": fault.place,
        "always": fault.always,
        "tried": len(outcomes),
        "held": held,
        "held_95": list(wilson_interval(held, len(outcomes))),
        "worst_clearance_m": min(clearances, default=None),
        "recovery_s": max(recoveries, default=None),
        "why": dict(Counter(o.why for o in outcomes if not o.held).most_common(3)),
    }


def broken(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Name the faults whose promise is to hold always and did not."""
    return [row["fault"] for row in rows if row["always"] and row["held"] < row["tried"]]


TITLES = ("fault", "promise", "held", "95 %", "worst clearance", "recovery")


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """Write a row: name, promise, held of tried, Wilson interval, worst clearance, recovery."""
    low, high = row["held_95"]
    clearance, recovery = row["worst_clearance_m"], row["recovery_s"]
    return (
        row["fault"],
        row["promise"],
        f"{row['held']} of {row['tried']}",
        f"{100.0 * low:.1f} to {100.0 * high:.1f} %",
        "" if clearance is None else f"{clearance:.2f} m",
        "" if recovery is None else f"{recovery:.2f} s",
    )


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Write the table, one row a fault, with the command that tries it again."""
    titles = (*TITLES, "command")
    lines = [list(titles), ["---"] * len(titles)]
    lines += [[*cells(row), f"`gtmr faults {row['fault']}`"] for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
