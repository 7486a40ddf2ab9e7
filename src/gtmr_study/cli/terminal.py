# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the commands share: options, progress, and what is wrong in one clear line."""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from gtmr_study.result_files import InputError

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn

BAD_INPUT = 2
"""Exit code of bad input."""
INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""
OF_THE_MACHINE = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE, errno.ENFILE, errno.ENOMEM)
"""What the system says of a file where another file would do no better."""
UsageError: type[Exception] = typer.BadParameter.__bases__[0]
"""What wrong options raise; from typer, since it may carry its own copy of click."""


MAX_SEED = 2**63 - 1
"""Largest seed: a ROS parameter holds no larger number."""


def option(metavar: str, text: str, default: str = "", **limits: int) -> Any:
    """Describe an option of a command: what its value is called, its help, and its default.

    The default is only said here; it may be more than a value, as ``one per processor``.
    """
    told = f"{text}  [default: {default}]" if default else text
    return typer.Option(metavar=metavar, help=told, show_default=False, **limits)  # type: ignore[arg-type]


JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON.")
]
DurationOption = Annotated[float, option("S", "Length of a flight [s].", "50")]
VehicleOption = Annotated[
    str | None, option("NAME|YAML", "Vehicle: a preset or a file.", "the controller's")
]
WorldOption = Annotated[
    str | None, option("NAME|YAML", "What the vehicle meets: a preset or a file.", "paper")
]
DRefOption = Annotated[
    float | None,
    option("M", "Distance of the helix from the tower's surface [m].", "the controller's"),
]
ZetaNumbers = tuple[float, float, float, float, float, float, float, float, float]
ZETA_HELP = "True mismatch: mass, J_x, J_y, J_z, thrust, drag [-], wind bias x, y, z [N]."
ControllerOption = Annotated[
    str | None, option("NAME|YAML", "Controller: a preset or a file.", "that of the world")
]
CONTROLLER_OR_OWN = option(
    "NAME|YAML|FILE.py:CLASS",
    "Controller: a preset, a file, or a class of your own.",
    "that of the world",
)

# A path or a value may hold what stands for a picture, as :A: does.
console = Console(emoji=False)
"""For results and progress."""
_errors = Console(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)


def complain(reason: object) -> None:
    """Say on stderr, in one line, what is wrong."""
    # Only now, as what the help needs must not load CasADi.
    from gtmr_model.yaml_file import printable

    _errors.print(f"gtmr: {printable(str(reason))}")


def progress(amount: ProgressColumn | None = None) -> Progress:
    """Make a progress bar that shows on a terminal only, and is gone when the work is done.

    It tells the amount done in percent unless another column is given.
    """
    # Only now, as the help does without.
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

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
        complain(_refusal(error))
        return BAD_INPUT
    except (typer.Abort, KeyboardInterrupt):
        code = INTERRUPTED
    except Exception as error:
        from gtmr_model import ConfigError
        from gtmr_monitor.bag.format import BagError
        from gtmr_sim import FlightFileError

        if isinstance(error, (ConfigError, InputError, BagError, FlightFileError)):
            complain(error)
            return BAD_INPUT
        if not isinstance(error, OSError) or error.filename is None:
            raise
        complain(f"{os.fsdecode(error.filename)}: {error.strerror}")
        return 1 if error.errno in OF_THE_MACHINE else BAD_INPUT
    if code == INTERRUPTED:
        complain("interrupted")
    return code


def _refusal(error: Exception) -> str:
    """Say which option was refused, which value it had and why."""
    said: Any = error
    cause: Any = error.__cause__
    problems = cause.errors() if hasattr(cause, "errors") else []
    option = next(iter(getattr(getattr(said, "param", None), "opts", None) or []), "")
    if not problems or not option:
        return str(said.format_message())
    value, reason = problems[0]["input"], problems[0]["msg"]
    return f"{option} = {value}: {reason}"


def require_seed(seed: int | None, most: int = MAX_SEED) -> None:
    """Refuse a seed that is none; None is one that is left out."""
    if seed is not None and not 0 <= seed <= most:
        raise InputError(f"--seed = {seed}: allowed is 0 to {most}")


def require_choice(option: str, value: str, allowed: Collection[str]) -> None:
    """Check that a value is one of those there are; InputError names them if it is not."""
    if value not in allowed:
        raise InputError(f"{option} = {value!r}: allowed is {', '.join(allowed)}")


def needs_ros(what: str, error: ModuleNotFoundError) -> InputError:
    """Make the refusal of what cannot be done without ROS."""
    return InputError(f"{what} needs ROS 2, but there is no {error.name}: make setup")
