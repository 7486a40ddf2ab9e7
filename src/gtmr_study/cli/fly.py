# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The command ``gtmr fly``, and what it shares with ``gtmr demo``."""

import io
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from gtmr_model import Helix, Vehicle
from gtmr_monitor.residual import residual_statistics, solve_statistics
from gtmr_nmpc import MODES, Controller, ControllerConfig
from gtmr_sim import GUST_KINDS, GUSTS, FlightError, Scenario, StepController, World, fly
from gtmr_study.campaign.study import controller_for, worst_gusts
from gtmr_study.cli.terminal import (
    CONTROLLER_OR_OWN,
    DRefOption,
    DurationOption,
    JsonOption,
    VehicleOption,
    WorldOption,
    console,
    figures,
    option,
    print_columns,
    progress,
    require_choice,
)
from gtmr_study.own_controller import OwnController
from gtmr_study.result_files import (
    InputError,
    require_folder_of,
    require_new_file,
    write_json,
    write_whole,
)

Zeta = tuple[float, float, float, float, float, float, float, float, float]


def fly_command(
    mode: Annotated[str | None, option("|".join(MODES), "Controller.  [robust]")] = None,
    seed: Annotated[int, option("K", "Seed of gusts and of --sample.")] = 0,
    duration: DurationOption = 50.0,
    zeta: Annotated[
        Zeta | None,
        option(
            "9 NUMBERS",
            "True mismatch: mass, J_x, J_y, J_z, thrust, drag [-], wind bias x, y, z [N].",
        ),
    ] = None,
    sample: Annotated[
        bool, typer.Option("--sample", help="Draw the true mismatch from its bounds by the seed.")
    ] = False,
    gust: Annotated[str, option("|".join(GUST_KINDS), "Gusts.")] = "ou",
    world: WorldOption = None,
    d_ref: DRefOption = None,
    vehicle: VehicleOption = None,
    controller: Annotated[str | None, CONTROLLER_OR_OWN] = None,
    scenario: Annotated[
        Path | None, option("FILE.yaml", "A flight that gtmr attack found; it says all else.")
    ] = None,
    out: Annotated[Path | None, option("FILE.npz", "Write the flight, row by row.")] = None,
    json: JsonOption = None,
) -> None:
    """Fly one closed loop in this process, without ROS."""
    require_duration(duration)
    if out is not None and out.suffix != ".npz":
        raise InputError(f"--out = {out}: expected a name that ends in .npz")
    require_new_file("--out", out)
    require_folder_of("--json", json)
    if scenario is not None:
        others = (mode, zeta, world, d_ref, vehicle, controller, sample or None)
        usual = (seed, duration, gust) == (0, 50.0, "ou")
        if not usual or any(other is not None for other in others):
            raise InputError(f"--scenario = {scenario}: says it all; leave out the rest")
        from gtmr_study.attack.space import AttackFlight

        again = AttackFlight.from_yaml(scenario)
        pilot, named = Controller(again.controller, again.mode), str(scenario)
        period_s = again.controller.sampling_time_s
        duration = again.duration_s
        try:
            _fly_and_tell(again.scenario, pilot, again.mode, duration, period_s, named, out, json)
        except FlightError as error:
            raise InputError(f"--scenario = {scenario}: {error}") from None
        return
    own = None if controller is None else OwnController.named("--controller", controller)
    if own is not None and mode is not None:
        raise InputError(f"--mode = {mode}: {own.name} has no modes; leave it out")
    mode = mode or "robust"
    require_choice("--mode", mode, MODES)
    require_choice("--gust", gust, GUSTS.names())
    if zeta is not None and sample:
        raise InputError("--zeta and --sample: give one of them")

    met = World.load("world", world or "paper")
    told = controller if controller is not None and own is None else controller_for(met)
    config = at_distance(ControllerConfig.load("controller", told), d_ref)
    if vehicle is not None:
        config = config.model_copy(update={"vehicle": Vehicle.load("vehicle", vehicle)})
    sequence = worst_gusts(config, own.name if own else mode) if gust == "l1" else None
    met_there = Scenario.parse(
        {
            "vehicle": config.vehicle,
            "tower": config.tower,
            "helix": config.helix,
            "uncertainty": config.uncertainty,
            "gust": {"kind": gust, **({} if sequence is None else {"sequence": sequence})},
            "world": met,
            "seed": seed,
            **({} if zeta is None else {"zeta": zeta}),
        },
        "flight",
    )
    if sample:
        met_there = met_there.sampled()

    flown: StepController
    if own is None:
        flown = Controller(config, mode)  # type: ignore[arg-type]
    else:
        flown, mode = own.make(config), own.name
    try:
        named, period_s = world or "paper", config.sampling_time_s
        _fly_and_tell(met_there, flown, mode, duration, period_s, named, out, json)
    except FlightError as error:
        raise InputError(f"--controller = {controller or told}: {error}") from None


def _fly_and_tell(
    scenario: Scenario,
    flown: StepController,
    mode: str,
    duration: float,
    period_s: float,
    world: str,
    out: Path | None,
    json: Path | None,
) -> None:
    """Fly, and tell and write what came of it."""
    with progress() as bar:
        task = bar.add_task(f"{mode}, {duration:g} s", total=round(duration / period_s))

        def show(step: int) -> None:
            bar.update(task, completed=step)

        log = fly(scenario, flown, duration, period_s, show)
    if out is not None:
        content = io.BytesIO()
        log.save(content)
        write_whole(out, content.getvalue())
    d_min = scenario.tower.min_clearance_m
    result: dict[str, Any] = {
        "mode": mode,
        "seed": scenario.seed,
        "duration_s": duration,
        "gust": scenario.gust.kind,
        "world": world,
        "zeta": list(scenario.zeta),
        **residual_statistics(d_min - log.d_T, d_min),
        "min_airframe_clearance_m": float(log.d_airframe.min()),
        "solve_ms": solve_statistics(log.solve_ms),
        "failed_steps": log.failed_steps,
        "max_slack_m": log.max_slack_m,
        "min_clearance_any_time_m": log.least_clearance_m,
        "steady_wind_within": log.steady_wind_within,
        "gusts_within": log.gusts_within,
    }
    print_flights({mode: result})
    if out is not None:
        console.print(f"Flight: {out}")
    write_json(json, result)


def at_distance(config: ControllerConfig, d_ref_m: float | None) -> ControllerConfig:
    """Return a controller whose helix is at a distance from the tower [m]; None changes nothing.

    ConfigError if there can be no such helix, or the controller follows another path.
    """
    if d_ref_m is None:
        return config
    data = Helix.required(config.helix).model_dump() | {"offset_m": d_ref_m}
    return config.model_copy(update={"helix": Helix.parse(data, f"--d-ref = {d_ref_m:g}")})


def require_duration(duration: float) -> None:
    """Refuse a length of a flight [s] that is none."""
    if not 0.025 <= duration <= 86400.0:
        raise InputError(f"--duration = {duration:g}: allowed is 0.025 to 86400 s")


def print_flights(results: dict[str, dict[str, Any]]) -> None:
    """Print flights beside each other, one column a mode."""
    rows = {
        "least clearance [m]": lambda r: f"{r['min_clearance_m']:.3f}",
        "clearance violated": lambda r: "yes" if r["violated"] else "no",
        "residual quartiles [m]": figures("residual_m", ("q1", "median", "q3"), 3),
        "solve time median, p99 [ms]": figures("solve_ms", ("median", "p99"), 2),
    }
    print_columns(Table("", *results, box=SIMPLE_HEAD), rows, results)
