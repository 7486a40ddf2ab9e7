# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command ``gtmr faults``: every fault with its promise, tried and counted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from gtmr_study.cli.tables import explains, new_table
from gtmr_study.cli.terminal import (
    JsonOption,
    complain,
    console,
    needs_ros,
    progress,
    require_choice,
)
from gtmr_study.result_files import require_folder_of, write_json

if TYPE_CHECKING:
    from gtmr_study.faults.fault import Fault


WORDS = {
    "fault": "What is done wrong; its name runs it alone.",
    "promise": "What the suite must do all the same.",
    "held": "In how many tries the promise was kept.",
    "95 %": "Wilson interval of the share held: it is within, with a confidence of 95 %.",
    "worst clearance": "Least distance of the vehicle's centre from the tower in any try.",
    "recovery": "Longest time until all was well again.",
}
"""What the columns are."""


def catalogue() -> dict[str, Fault]:
    """Give every fault by name: in process, on files, and between nodes."""
    from gtmr_study.faults import catalogue as without_ros

    try:
        from gtmr_study.ros.faults import messages, nodes
    except ModuleNotFoundError as error:
        raise needs_ros("gtmr faults", error) from None
    with_ros = (*messages.faults(), *nodes.faults())
    return without_ros.faults() | {fault.name: fault for fault in with_ros}


@explains(WORDS)
def faults_command(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[FAULT...]", help="Only these.  [default: all]")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few tries of each, in about a minute.")
    ] = False,
    json: JsonOption = None,
) -> int:
    """Try faults, and count how often what is promised under them was kept."""
    from gtmr_study.faults.campaign import TITLES, broken, cells, try_faults

    require_folder_of("--json", json)
    there = catalogue()
    for name in names or ():
        require_choice("FAULT", name, list(there))
    chosen = list(dict.fromkeys(names or there))
    total = sum(there[name].quick if quick else there[name].tries for name in chosen)
    done: dict[str, int] = {}
    with progress() as bar:
        task = bar.add_task("faults", total=total)

        def show(name: str, tries: int) -> None:
            done[name] = tries
            bar.update(task, completed=sum(done.values()), description=name)

        rows = try_faults(catalogue, chosen, quick, show)
    write_json(json, rows)
    table = new_table(*TITLES)
    # The name is what one types; the promise is a sentence, no figure.
    table.columns[0].no_wrap = True
    table.columns[1].justify = "left"
    for row in rows:
        table.add_row(*map(Text, cells(row)))
    console.print(table)
    for name in broken(rows):
        (row,) = (row for row in rows if row["fault"] == name)
        reasons = "; ".join(f"{count} times {why}" for why, count in row["why"].items())
        complain(f"{name}: not held {row['tried'] - row['held']} of {row['tried']}: {reasons}")
    return min(len(broken(rows)), 1)
