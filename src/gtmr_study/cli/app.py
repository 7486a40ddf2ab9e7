# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command line ``gtmr``: one command a job, bad input in one line with exit code 2."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from gtmr_model import Vehicle
from gtmr_monitor.residual import residual_statistics, solve_statistics
from gtmr_nmpc import MODES, Controller, ControllerConfig
from gtmr_sim import GUST_KINDS, GustConfig, Scenario, fly
from gtmr_study.cli.bench import bench_command
from gtmr_study.cli.campaign import calibrate_command, campaign_command, reproduce_command
from gtmr_study.cli.export import export_c_command
from gtmr_study.cli.replay import play_command, replay_command, truncation_told
from gtmr_study.cli.terminal import (
    complain,
    console,
    exit_code_of,
    needs_ros,
    progress,
    require_choice,
)
from gtmr_study.result_files import (
    InputError,
    require_empty_folder,
    require_folder_of,
    require_new_file,
    write_json,
)

if TYPE_CHECKING:
    from gtmr_study.ros.live import LiveView

Zeta = tuple[float, float, float, float, float, float, float, float, float]

app = typer.Typer(
    help="Close-proximity tower inspection with a tilted multirotor: nominal and robust NMPC.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

app.command("bench")(bench_command)
app.command("export-c")(export_c_command)
app.command("campaign")(campaign_command)
app.command("reproduce")(reproduce_command)
app.command("calibrate")(calibrate_command)
app.command("replay")(replay_command)
app.command("play")(play_command)

JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON.")
]
DurationOption = Annotated[float, typer.Option(metavar="S", help="Length of a flight [s].")]


@app.command("fly")
def fly_command(
    mode: Annotated[str, typer.Option(metavar="|".join(MODES), help="Controller.")] = "robust",
    seed: Annotated[int, typer.Option(metavar="K", help="Seed of gusts and of --sample.")] = 0,
    duration: DurationOption = 50.0,
    zeta: Annotated[
        Zeta | None,
        typer.Option(
            metavar="9 NUMBERS",
            help="True mismatch: mass, J_x, J_y, J_z, thrust, drag [-], wind bias x, y, z [N].",
        ),
    ] = None,
    sample: Annotated[
        bool, typer.Option("--sample", help="Draw the true mismatch from its bounds by the seed.")
    ] = False,
    gust: Annotated[str, typer.Option(metavar="|".join(GUST_KINDS), help="Gusts.")] = "ou",
    vehicle: Annotated[
        str | None, typer.Option(metavar="NAME|YAML", help="Preset or file under config/vehicle.")
    ] = None,
    controller: Annotated[
        str, typer.Option(metavar="NAME|YAML", help="Preset or file under config/controller.")
    ] = "default",
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.npz", help="Write the flight, row by row.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Fly one closed loop in this process, without ROS."""
    _require_duration(duration)
    require_choice("--mode", mode, MODES)
    require_choice("--gust", gust, GUST_KINDS)
    if zeta is not None and sample:
        raise InputError("--zeta and --sample: give one of them")
    if out is not None and out.suffix != ".npz":
        raise InputError(f"--out = {out}: expected a name that ends in .npz")
    require_new_file("--out", out)
    require_folder_of("--json", json)

    config = ControllerConfig.load("controller", controller)
    if vehicle is not None:
        chosen = Vehicle.load("vehicle", vehicle)
        config = config.model_copy(update={"vehicle": chosen})
    scenario = Scenario.parse(
        {
            "vehicle": config.vehicle,
            "tower": config.tower,
            "helix": config.helix,
            "uncertainty": config.uncertainty,
            "gust": GustConfig(kind=gust),
            "seed": seed,
            **({} if zeta is None else {"zeta": zeta}),
        },
        "flight",
    )
    if sample:
        scenario = scenario.sampled()

    steps = round(duration / config.sampling_time_s)
    with progress() as bar:
        task = bar.add_task(f"{mode}, {duration:g} s", total=steps)
        log = fly(
            scenario,
            Controller(config, mode),  # type: ignore[arg-type]
            duration,
            config.sampling_time_s,
            on_step=lambda k: bar.update(task, completed=k),
        )
    if out is not None:
        log.save(out)
    d_min = scenario.tower.min_clearance_m
    result: dict[str, Any] = {
        "mode": mode,
        "seed": seed,
        "duration_s": duration,
        "gust": gust,
        "zeta": list(scenario.zeta),
        **residual_statistics(d_min - log.d_T, d_min),
        "solve_ms": solve_statistics(log.solve_ms),
        "failed_steps": int(log.failed.sum()),
        "max_slack_m": float(log.slack.max()),
    }
    write_json(json, result)
    _print_table({mode: result})
    if out is not None:
        console.print(f"Flight: {out}")


@app.command("demo")
def demo_command(
    duration: DurationOption = 50.0,
    modes: Annotated[
        str, typer.Option(metavar="MODE,...", help="Which modes to fly, one after the other.")
    ] = ",".join(MODES),
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of bags and report; new or empty.  [bags/demo-*]"
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Show the flights on a page in the browser.")
    ] = False,
    json: JsonOption = None,
) -> None:
    """Fly the helix round the tower with three ROS 2 nodes, once a mode; record and report."""
    _require_duration(duration)
    chosen = modes.split(",")
    for mode in chosen:
        require_choice("--modes", mode, MODES)
    if len(set(chosen)) < len(chosen):
        raise InputError(f"--modes = {modes!r}: names a mode twice")
    folder = out if out is not None else Path("bags") / time.strftime("demo-%Y-%m-%d-%H-%M-%S")
    require_empty_folder("--out", folder)
    require_folder_of("--json", json)
    try:
        from gtmr_study.ros.demo import DemoError, fly_in_ros
    except ModuleNotFoundError as error:
        raise needs_ros("the demo", error) from None
    from gtmr_monitor.bag.flight import read_flight
    from gtmr_monitor.report.page import write_report

    view = _live_view(duration, chosen) if live else None
    console.print(
        "Flying a tilted hexarotor round a tower of 2 m diameter, 0.35 m from its surface, in a "
        "steady wind with gusts. It must not come closer than 0.20 m. Three processes make up a "
        "ROS 2 graph: simulator, controller and monitor."
    )
    results: dict[str, dict[str, Any]] = {}
    flights = []
    for mode in chosen:
        with progress() as bar:
            task = bar.add_task(f"{mode}: starting the nodes", total=duration)

            def show(time_s: float, clearance_m: float, mode: str = mode) -> None:
                text = f"{mode}: {time_s:4.1f} of {duration:g} s, clearance {clearance_m:.2f} m"
                bar.update(task, completed=time_s, description=text)  # noqa: B023

            try:
                bag = fly_in_ros(mode, duration, folder / mode, show, view)
            except DemoError as error:
                complain(error)
                raise typer.Exit(1) from None
        flight = read_flight(bag)
        flights.append(flight)
        results[mode] = {
            **flight.residual_statistics,
            "solve_ms": flight.solve_statistics,
            "deadline_misses": flight.deadline_misses,
            "bag": str(bag),
        }
        console.print(f"{mode}: flown {duration:g} s, recorded in {bag}")
    write_report(flights, folder / "report.html")
    write_json(json, {"modes": results})
    _print_table(results)
    console.print(
        f"Report:  {folder / 'report.html'} (open it in a browser)\n"
        f"Bags:    {', '.join(r['bag'] for r in results.values())} "
        "(Foxglove, or ros2 bag play)\n"
        "Next:    gtmr fly --help, README.md"
    )
    if view is not None and console.is_terminal:
        with contextlib.suppress(EOFError, KeyboardInterrupt):
            console.input(f"Live view: {view.page.url} until you press Enter ")


@app.command("report")
def report_command(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="PATH...", help="Bags, or folders of campaigns."),
    ],
    out: Annotated[
        Path, typer.Option(metavar="FILE.html", help="The report; figures go beside it.")
    ] = Path("report.html"),
    vehicle: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Of bags with several vehicles, only this one."),
    ] = None,
) -> None:
    """Make one self-contained HTML report, and PNG figures, of bags or of campaigns."""
    from gtmr_study.campaign.trials_file import is_campaign

    require_new_file("--out", out)
    if any(is_campaign(path) for path in paths):
        from gtmr_study.campaign.report import write_campaign_report

        written = write_campaign_report(paths, out)
    else:
        from gtmr_monitor.bag.flight import read_flights
        from gtmr_monitor.report.page import write_report

        with truncation_told():
            flights = [flight for path in paths for flight in read_flights(path, vehicle)]
        for flight in flights:
            for note in flight.notes:
                complain(f"warning: {flight.name}: {note}")
        written = write_report(flights, out)
    console.print("\n".join(str(path) for path in written))


def _live_view(duration: float, modes: list[str]) -> LiveView:
    """Serve the page of the live view, which needs viser."""
    try:
        from gtmr_study.ros.live import LiveView
    except ModuleNotFoundError as error:
        raise InputError(f"--live needs {error.name}: pip install 'gtmr[live]'") from None
    view = LiveView(duration, modes)
    console.print(f"Live view: {view.page.url} (open it in a browser)")
    return view


def _require_duration(duration: float) -> None:
    if not 0.025 <= duration <= 86400.0:
        raise InputError(f"--duration = {duration:g}: allowed is 0.025 to 86400 s")


def _print_table(results: dict[str, dict[str, Any]]) -> None:
    """Print flights beside each other, one column a mode."""
    table = Table("", *results, box=SIMPLE_HEAD)
    rows = {
        "least clearance [m]": lambda r: f"{r['min_clearance_m']:.3f}",
        "clearance violated": lambda r: "yes" if r["violated"] else "no",
        "residual quartiles [m]": lambda r: ", ".join(
            f"{r['residual_m'][key]:.3f}" for key in ("q1", "median", "q3")
        ),
        "solve time median, p99 [ms]": lambda r: ", ".join(
            f"{r['solve_ms'][key]:.2f}" for key in ("median", "p99")
        ),
    }
    for name, cell in rows.items():
        table.add_row(Text(name), *(cell(result) for result in results.values()))
    console.print(table)


def main() -> None:
    """Run the command line; the exit code is 0, 2 for bad input, 1 for anything else."""
    command = typer.main.get_command(app)
    sys.exit(exit_code_of(lambda: command.main(prog_name="gtmr", standalone_mode=False)))
