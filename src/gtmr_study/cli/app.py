# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command line ``gtmr``: one command a job, bad input in one line with exit code 2."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from gtmr_study.cli.bench import bench_command
from gtmr_study.cli.campaign import calibrate_command, campaign_command, reproduce_command
from gtmr_study.cli.demo import demo_command
from gtmr_study.cli.export import export_c_command
from gtmr_study.cli.fly import fly_command
from gtmr_study.cli.replay import damage_told, play_command, replay_command, tell_coverage
from gtmr_study.cli.terminal import complain, console, exit_code_of, option
from gtmr_study.result_files import InputError, require_new_file

app = typer.Typer(
    help="Close-proximity tower inspection with a tilted multirotor: nominal and robust NMPC.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

app.command("fly")(fly_command)
app.command("demo")(demo_command)
app.command("bench")(bench_command)
app.command("export-c")(export_c_command)
app.command("campaign")(campaign_command)
app.command("reproduce")(reproduce_command)
app.command("calibrate")(calibrate_command)
app.command("replay")(replay_command)
app.command("play")(play_command)


@app.command("report")
def report_command(
    paths: Annotated[
        list[Path], typer.Argument(metavar="PATH...", help="Bags, or folders of campaigns.")
    ],
    out: Annotated[Path, option("FILE.html", "The report; figures go beside it.")] = Path(
        "report.html"
    ),
    vehicle: Annotated[
        str | None, option("NAME", "Of bags with several vehicles, only this one.")
    ] = None,
) -> None:
    """Make one self-contained HTML report, and PNG figures, of bags or of campaigns."""
    from gtmr_study.campaign.trials_file import is_campaign

    require_new_file("--out", out)
    if any(is_campaign(path) for path in paths):
        if vehicle is not None:
            raise InputError(f"--vehicle = {vehicle!r}: allowed with bags, not with campaigns")
        from gtmr_study.campaign.report import write_campaign_report

        written = write_campaign_report(paths, out)
    else:
        from gtmr_monitor.bag.flight import read_flights
        from gtmr_monitor.report.page import write_report

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
    command = typer.main.get_command(app)
    sys.exit(exit_code_of(lambda: command.main(prog_name="gtmr", standalone_mode=False)))
