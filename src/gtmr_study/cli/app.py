# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command line ``gtmr``: one command a job, bad input in one line with exit code 2."""

import ast
import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from gtmr_study.cli.terminal import complain, console, exit_code_of, option
from gtmr_study.result_files import InputError, require_new_file

MODULES = {
    "fly": "fly",
    "demo": "demo",
    "bench": "bench",
    "export-c": "export",
    "campaign": "campaigns.campaign",
    "reproduce": "campaigns.campaign",
    "calibrate": "campaigns.campaign",
    "attack": "campaigns.attack",
    "arena": "campaigns.arena",
    "faults": "campaigns.faults",
    "replay": "replay",
    "play": "replay",
    "recover": "replay",
    "report": "app",
}
"""Module of every command, beside this one; there ``export-c`` is ``export_c_command``."""


SETTINGS = {"max_content_width": 100}
"""Help is as wide as the terminal, up to so many columns."""


class Commands(TyperGroup):
    """Loads the module of a command when it is called: all of them together take seconds."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of the commands."""
        return list(MODULES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Load a command by its name; None if there is none."""
        if cmd_name not in MODULES:
            return None
        module = import_module(f"gtmr_study.cli.{MODULES[cmd_name]}")
        function = getattr(module, _function(cmd_name))
        # Only now: tables take rich, which the list of commands does not need.
        from gtmr_study.cli.tables import ExplainedCommand

        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        alone.command(cmd_name, cls=ExplainedCommand, context_settings=SETTINGS)(function)
        command: Any = typer.main.get_command(alone)
        command.words = getattr(function, "words", {})
        return command

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write what each command does, as its source says."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, _said_of(name)) for name in MODULES])


def _function(name: str) -> str:
    return f"{name.replace('-', '_')}_command"


def _said_of(name: str) -> str:
    """First line of a command's docstring, without loading it."""
    module = Path(__file__).parent.joinpath(*MODULES[name].split(".")).with_suffix(".py")
    source = module.read_text(encoding="utf-8")
    functions = {f.name: f for f in ast.parse(source).body if isinstance(f, ast.FunctionDef)}
    return (ast.get_docstring(functions[_function(name)]) or "").partition("\n")[0]


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings=SETTINGS,
)


def _tell_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        console.print(f"gtmr {version('gtmr')}", highlight=False)
        raise typer.Exit


@app.callback()
def gtmr(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_tell_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    """Close-proximity tower inspection with a tilted multirotor: nominal and robust NMPC."""


def report_command(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="PATH...", help="Bags, flights (.npz), or folders of campaigns."),
    ],
    out: Annotated[
        Path, option("FILE.html", "The report; figures go beside it.", "report.html")
    ] = Path("report.html"),
    vehicle: Annotated[
        str | None, option("NAME", "Of bags with several vehicles, only this one.")
    ] = None,
) -> None:
    """Make one self-contained HTML report, and PNG figures, of flights or of campaigns."""
    from gtmr_study.campaign.trials_file import is_campaign

    require_new_file("--out", out)
    if any(is_campaign(path) for path in paths):
        if vehicle is not None:
            raise InputError(f"--vehicle = {vehicle!r}: allowed with bags, not with campaigns")
        if not all(is_campaign(path) for path in paths):
            raise InputError("PATH...: campaigns and flights in one report: give one kind")
        from gtmr_study.campaign.report.page import write_campaign_report

        written = write_campaign_report(paths, out)
    elif any(path.suffix == ".npz" for path in paths):
        if vehicle is not None:
            raise InputError(f"--vehicle = {vehicle!r}: allowed with bags, not with flights")
        if not all(path.suffix == ".npz" for path in paths):
            raise InputError("PATH...: bags and flights (.npz) in one report: give one kind")
        from gtmr_sim import FlightLog
        from gtmr_study.cli.fly import write_log_report

        written = write_log_report([(FlightLog.load(path), path) for path in paths], out)
    else:
        from gtmr_monitor.bag.flight import read_flights
        from gtmr_monitor.report.page import write_report
        from gtmr_study.cli.replay import damage_told, tell_coverage

        with damage_told():
            flights = [flight for path in paths for flight in read_flights(path, vehicle)]
        for flight in flights:
            tell_coverage(flight.name, flight.coverage)
            for note in flight.notes:
                complain(f"warning: {flight.name}: {note}")
        written = write_report(flights, out)
    console.print("\n".join(str(path) for path in written))


def main() -> None:
    """Run the command line; the exit code is 0, 2 for bad input, 1 for anything else."""
    command = typer.main.get_group(app)
    sys.exit(exit_code_of(lambda: command.main(prog_name="gtmr", standalone_mode=False)))
