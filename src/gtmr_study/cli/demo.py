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

import numpy as np
import typer

from gtmr_model import Helix, Vehicle
from gtmr_nmpc import MODES, ControllerConfig
from gtmr_sim import GUST_KINDS, GUSTS, Scenario, World
from gtmr_sim.flying.log import SLACK_TOLERANCE_M
from gtmr_study.campaign.study import controller_for
from gtmr_study.cli.fly import FLIGHT_ROWS, FLIGHT_WORDS, require_duration, scenario_for
from gtmr_study.cli.replay import damage_told, tell_coverage
from gtmr_study.cli.tables import explains, print_rows
from gtmr_study.cli.terminal import (
    ZETA_HELP,
    ControllerOption,
    DurationOption,
    JsonOption,
    VehicleOption,
    WorldOption,
    ZetaNumbers,
    complain,
    console,
    needs_ros,
    option,
    progress,
    require_choice,
    require_seed,
)
from gtmr_study.result_files import InputError, require_empty_folder, require_folder_of, write_json

if TYPE_CHECKING:
    from gtmr_monitor.flight import Flight
    from gtmr_study.ros.live import LiveView


WIND_BIAS_N = (0.6, 0.4, 0.0)
"""w_b of Fig. 1, world frame [N], in which the demo flies unless told otherwise."""


@explains(FLIGHT_WORDS)
def demo_command(
    duration: DurationOption = 50.0,
    modes: Annotated[
        str, option("MODE,...", "Which modes to fly, one after the other.", ",".join(MODES))
    ] = ",".join(MODES),
    seed: Annotated[int, option("K", "Seed of the gusts.", "0")] = 0,
    zeta: Annotated[
        ZetaNumbers | None, option("9 NUMBERS", ZETA_HELP, "a wind bias of 0.6, 0.4, 0 N")
    ] = None,
    gust: Annotated[str, option("|".join(GUST_KINDS), "Gusts.", "ou")] = "ou",
    world: WorldOption = None,
    vehicle: VehicleOption = None,
    controller: ControllerOption = None,
    out: Annotated[
        Path | None, option("DIR", "Folder of bags and report; new or empty.", "bags/demo-*")
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
    require_seed(seed)
    require_choice("--gust", gust, GUSTS.names())
    if controller is not None and ".py" in controller:
        raise InputError(
            f"--controller = {controller}: the demo flies the node of the suite; a controller of "
            "your own flies with gtmr fly and gtmr campaign"
        )
    # All of it before anything is started.
    met = world if world is not None else "paper"
    loaded = World.load("world", met)
    told = controller if controller is not None else controller_for(loaded)
    config = ControllerConfig.load("controller", told)
    if vehicle is not None:
        config = config.model_copy(update={"vehicle": Vehicle.load("vehicle", vehicle)})
    helix = Helix.required(config.helix)
    true_zeta = zeta if zeta is not None else (*(0.0,) * 6, *WIND_BIAS_N)
    scenarios = {
        mode: scenario_for(config, mode, loaded, gust, seed, true_zeta) for mode in chosen
    }
    folder = out if out is not None else Path("bags") / time.strftime("demo-%Y-%m-%d-%H-%M-%S")
    require_empty_folder("--out", folder)
    require_folder_of("--json", json)
    try:
        from gtmr_study.ros.demo import DemoError, InRos, fly_in_ros
    except ModuleNotFoundError as error:
        raise needs_ros("the demo", error) from None
    from gtmr_monitor.bag.flight import read_flight
    from gtmr_monitor.report.page import write_report

    view = _live_view(duration, chosen, scenarios[chosen[0]]) if live else None
    tower = config.tower
    console.print(
        f"Flying {config.vehicle.name} around a tower of {2.0 * tower.radius_m:g} m diameter, "
        f"{helix.offset_m:g} m from its surface. It must not come closer than "
        f"{tower.min_clearance_m:g} m. Three processes make up a ROS 2 graph: simulator, "
        "controller and monitor.",
        highlight=False,
        markup=False,
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
                bag = fly_in_ros(
                    InRos(mode, told, met, config, scenarios[mode]),
                    duration,
                    folder / mode,
                    show,
                    view,
                )
            except DemoError as error:
                complain(error)
                raise typer.Exit(1) from None
        with damage_told():
            flight = read_flight(bag)
        tell_coverage(f"{mode} flight", flight.coverage)
        flights.append(flight)
        results[mode] = {
            **flight.residual_statistics,
            **_tracking(flight),
            "solve_ms": flight.solve_statistics,
            "deadline_misses": flight.deadline_misses,
            "bag": str(bag),
            "clearance_from": flight.clearance_from,
            "coverage": flight.coverage.as_json(),
            "guard_time_s": flight.guard_time_s,
        }
        console.print(f"{mode}: flown {duration:g} s, recorded in {bag}")
    write_report(flights, folder / "report.html")
    print_rows(FLIGHT_ROWS, results)
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


def _tracking(flight: Flight) -> dict[str, Any]:
    """Say how far a recorded flight was from its reference, and where plans gave way."""
    off_m = flight.tower.clearance(flight.p) - flight.helix.clearance(flight.t, flight.tower)
    slack = flight.margins.slack
    return {
        "radial_rms_m": float(np.sqrt(np.mean(off_m**2))),
        "tracking_rms_m": float(np.sqrt(np.mean(flight.tracking_error**2))),
        "max_slack_m": float(slack.max()) if slack.size else None,
        "softened_steps": int((slack.max(axis=1) > SLACK_TOLERANCE_M).sum())
        if slack.size
        else None,
    }


def _live_view(duration: float, modes: list[str], scenario: Scenario | None = None) -> LiveView:
    """Serve the page of the live view, which needs viser."""
    try:
        from gtmr_study.ros.live import LiveView
    except ModuleNotFoundError as error:
        raise InputError(f"--live needs {error.name}: pip install 'gtmr[live]'") from None
    view = LiveView(duration, modes, scenario)
    console.print(f"Live view: {view.page.url} (open it in a browser)")
    return view
