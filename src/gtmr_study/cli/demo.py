# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The command ``gtmr demo``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gtmr_nmpc import MODES
from gtmr_sim import World
from gtmr_study.cli.fly import print_flights, require_duration
from gtmr_study.cli.replay import damage_told, tell_coverage
from gtmr_study.cli.terminal import (
    DurationOption,
    JsonOption,
    WorldOption,
    complain,
    console,
    needs_ros,
    option,
    progress,
    require_choice,
)
from gtmr_study.result_files import InputError, require_empty_folder, require_folder_of, write_json

if TYPE_CHECKING:
    from gtmr_study.ros.live import LiveView


def demo_command(
    duration: DurationOption = 50.0,
    modes: Annotated[
        str, option("MODE,...", "Which modes to fly, one after the other.")
    ] = ",".join(MODES),
    world: WorldOption = None,
    out: Annotated[
        Path | None, option("DIR", "Folder of bags and report; new or empty.  [bags/demo-*]")
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Show the flights on a page in the browser.")
    ] = False,
    json: JsonOption = None,
) -> None:
    """Fly the helix around the tower with three ROS 2 nodes, once a mode; record and report."""
    require_duration(duration)
    chosen = modes.split(",")
    for mode in chosen:
        require_choice("--modes", mode, MODES)
    if len(set(chosen)) < len(chosen):
        raise InputError(f"--modes = {modes!r}: names a mode twice")
    met = world if world is not None else "paper"
    # Only to see whether it is one, before anything is started.
    World.load("world", met)
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
        "Flying a tilted hexarotor around a tower of 2 m diameter, 0.35 m from its surface, in a "
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
                bag = fly_in_ros(mode, duration, folder / mode, show, view, met)
            except DemoError as error:
                complain(error)
                raise typer.Exit(1) from None
        with damage_told():
            flight = read_flight(bag)
        tell_coverage(f"{mode} flight", flight.coverage)
        flights.append(flight)
        results[mode] = {
            **flight.residual_statistics,
            "solve_ms": flight.solve_statistics,
            "deadline_misses": flight.deadline_misses,
            "bag": str(bag),
            "clearance_from": flight.clearance_from,
            "coverage": flight.coverage.as_json(),
            "guard_time_s": flight.guard_time_s,
        }
        console.print(f"{mode}: flown {duration:g} s, recorded in {bag}")
    write_report(flights, folder / "report.html")
    print_flights(results)
    console.print(
        f"Report:  {folder / 'report.html'} (open it in a browser)\n"
        f"Bags:    {', '.join(r['bag'] for r in results.values())} "
        "(Foxglove, or ros2 bag play)\n"
        "Next:    gtmr fly --help, README.md"
    )
    write_json(json, {"modes": results})
    if view is not None:
        console.print(f"Live view: {view.page.url} shows the flights until Ctrl-C")
        view.stay()


def _live_view(duration: float, modes: list[str]) -> LiveView:
    """Serve the page of the live view, which needs viser."""
    try:
        from gtmr_study.ros.live import LiveView
    except ModuleNotFoundError as error:
        raise InputError(f"--live needs {error.name}: pip install 'gtmr[live]'") from None
    view = LiveView(duration, modes)
    console.print(f"Live view: {view.page.url} (open it in a browser)")
    return view
