# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the commands share: options, tables, progress, and what is wrong in one clear line."""

import errno
import io
import os
import sys
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, cast

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from gtmr_study.result_files import InputError

BAD_INPUT = 2
"""Exit code of bad input."""
INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""
OF_THE_MACHINE = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE, errno.ENFILE, errno.ENOMEM)
"""What the system says of a file where another file would do no better."""
UsageError: type[Exception] = typer.BadParameter.__bases__[0]
"""What wrong options raise; from typer, since it may carry its own copy of click."""


def option(metavar: str, text: str, **limits: int) -> Any:
    """Describe an option of a command: what its value is called, and its help."""
    return typer.Option(metavar=metavar, help=text, **limits)  # type: ignore[arg-type]


JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON.")
]
DurationOption = Annotated[float, option("S", "Length of a flight [s].")]
VehicleOption = Annotated[str | None, option("NAME|YAML", "Preset or file under config/vehicle.")]
WorldOption = Annotated[
    str | None,
    option("NAME|YAML", "What the vehicle meets: a preset or file under config/world.  [paper]"),
]
DRefOption = Annotated[
    float | None, option("M", "Distance of the helix from the tower's surface [m].  [0.35]")
]
CONTROLLER_OR_OWN = option(
    "NAME|YAML|FILE.py:CLASS",
    "Preset or file under config/controller, or a controller of your own.",
)

console = Console()
"""For results and progress."""
_errors = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)


def complain(reason: object) -> None:
    """Say on stderr, in one line, what is wrong."""
    # Only now, as what the help needs must not load CasADi.
    from gtmr_model.yaml_file import printable

    _errors.print(f"gtmr: {printable(str(reason))}")


def print_columns(
    table: Table, rows: dict[str, Callable[[Any], str]], results: Mapping[str, Any]
) -> None:
    """Print results beside each other, one column each, and what is said of them a row each."""
    for name, cell in rows.items():
        table.add_row(Text(name), *(cell(result) for result in results.values()))
    console.print(table)


def figures(key: str, names: tuple[str, ...], places: int) -> Callable[[Any], str]:
    """Say how some figures of one part of a result are written, to so many places."""
    return lambda result: ", ".join(f"{result[key][name]:.{places}f}" for name in names)


def progress(amount: ProgressColumn | None = None) -> Progress:
    """Make a progress bar that shows on a terminal only, and is gone when the work is done.

    It tells the amount done in percent unless another column is given.
    """
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        amount or TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def exit_code_of(command: Callable[[], Any]) -> int:
    """Run a command; what it refuses is said in one line.

    The exit code is the command's own (None is 0), 2 for bad input, a file that cannot be used
    among it, 1 if the machine has no room or a fault, or 130 after Ctrl-C.
    """
    # A name may hold bytes that are no text.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        # typer makes an exit code of its own of Ctrl-C in a command.
        code = command() or 0
    except UsageError as error:
        complain(cast(Any, error).format_message())
        return BAD_INPUT
    except (typer.Abort, KeyboardInterrupt):
        code = INTERRUPTED
    except Exception as error:
        from gtmr_model import ConfigError
        from gtmr_monitor.bag.format import BagError

        if isinstance(error, (ConfigError, InputError, BagError)):
            complain(error)
            return BAD_INPUT
        if not isinstance(error, OSError) or error.filename is None:
            raise
        complain(f"{os.fsdecode(error.filename)}: {error.strerror}")
        return 1 if error.errno in OF_THE_MACHINE else BAD_INPUT
    if code == INTERRUPTED:
        complain("interrupted")
    return code


def require_choice(option: str, value: str, allowed: Collection[str]) -> None:
    """Check that a value is one of those there are; InputError names them if it is not."""
    if value not in allowed:
        raise InputError(f"{option} = {value!r}: allowed is {', '.join(allowed)}")


def needs_ros(what: str, error: ModuleNotFoundError) -> InputError:
    """Make the refusal of what cannot be done without ROS."""
    return InputError(f"{what} needs ROS 2, but there is no {error.name}: make setup")
