# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""One style for the tables of all commands, and for what ``--help`` says of their words."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text
from typer.core import TyperCommand

from gtmr_study.cli.terminal import console

F = TypeVar("F", bound=Callable[..., Any])

MODE_WORDS = {
    "nominal": "Plans with the parameters that are believed, eq. (5).",
    "robust": "Tightens the clearance by margins for wrong parameters and gusts, eq. (15).",
    "offset_free": "Estimates what force and torque act, and tightens by margins of that loop.",
}
"""What the columns of a table say that has one a mode."""


@dataclass(frozen=True)
class Row:
    """A row of a table with one column a result."""

    name: str
    """What is told, with its unit; where it is indented it belongs to the row above."""
    meaning: str
    """The same for somebody who reads it for the first time."""
    cell: Callable[[Any], str]
    """Writes it of a result."""


def words_of(rows: Sequence[Row]) -> dict[str, str]:
    """Say what rows mean, by their names."""
    return {row.name: row.meaning for row in rows}


def explains(words: Mapping[str, str]) -> Callable[[F], F]:
    """Make a decorator that lets a command's help explain the words of its tables."""

    def decorate(command: F) -> F:
        command.words = words  # type: ignore[attr-defined]
        return command

    return decorate


class ExplainedCommand(TyperCommand):
    """A command whose help ends with the words of its tables."""

    words: Mapping[str, str] = {}
    """What they mean."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write them as options are written."""
        if self.words:
            with formatter.section("Words in the table"):
                formatter.write_dl(list(self.words.items()))


def new_table(first: str, *columns: str) -> Table:
    """Start a table: texts on the left, then columns of figures."""
    table = Table(box=SIMPLE_HEAD)
    # What has no room is broken into lines, titles between words, and never cut.
    table.add_column(first, overflow="fold")
    for column in columns:
        longest = max(map(len, column.split()), default=1)
        table.add_column(Text(column), justify="right", overflow="fold", min_width=longest)
    return table


def print_rows(rows: Sequence[Row], results: Mapping[str, Any]) -> None:
    """Print results beside each other, one column each."""
    table = new_table("", *results)
    for row in rows:
        table.add_row(Text(row.name), *(row.cell(result) for result in results.values()))
    console.print(table)


def number(places: int, *keys: str) -> Callable[[Any], str]:
    """Write one number of a result, found by its keys, to so many places; a dash if none."""

    def cell(result: Any) -> str:
        for key in keys:
            result = result[key]
        return "-" if result is None else f"{result:.{places}f}"

    return cell


def counted(key: str) -> Callable[[Any], str]:
    """Write a whole number of a result; a dash if none."""
    return lambda result: "-" if result[key] is None else str(result[key])
