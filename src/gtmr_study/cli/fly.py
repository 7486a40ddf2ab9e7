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

from gtmr_model import Vehicle
from gtmr_nmpc import MODES, Controller, ControllerConfig
from gtmr_sim import (
    GUST_KINDS,
    GUSTS,
    FlightError,
    FlightLog,
    Scenario,
    StepController,
    World,
    fly,
)
from gtmr_study.campaign.study import at_distance, controller_for, worst_gusts
from gtmr_study.cli.tables import MODE_WORDS, Row, explains, number, print_rows, words_of
from gtmr_study.cli.terminal import (
    CONTROLLER_OR_OWN,
    ZETA_HELP,
    DRefOption,
    DurationOption,
    JsonOption,
    VehicleOption,
    WorldOption,
    ZetaNumbers,
    console,
    option,
    progress,
    require_choice,
    require_seed,
)
from gtmr_study.own_controller import OwnController
from gtmr_study.result_files import (
    InputError,
    require_folder_of,
    require_new_file,
    write_json,
    write_whole,
)
from gtmr_study.scenario_file import ScenarioFile

REPORT_FILE = "report.html"


def _slack(result: Any) -> str:
    if result["softened_steps"] is None:
        return "-"
    return f"{result['max_slack_m']:.3f} in {result['softened_steps']}"


FLIGHT_ROWS = (
    Row(
        "least clearance [m]",
        "Least distance of the vehicle's centre from the tower's surface.",
        number(3, "min_clearance_m"),
    ),
    Row(
        "clearance violated",
        "Whether that was ever below d_min, the least admissible clearance.",
        lambda r: "yes" if r["violated"] else "no",
    ),
    Row(
        "residual, upper quartile [m]",
        "The residual is s = d_min - clearance: above 0 is a violation. Three quarters of the "
        "flight were below this.",
        number(3, "residual_m", "q3"),
    ),
    Row("  median [m]", "Half of the flight was below this.", number(3, "residual_m", "median")),
    Row(
        "  lower quartile [m]",
        "A quarter of the flight was below this.",
        number(3, "residual_m", "q1"),
    ),
    Row(
        "tracking error, radial [m]",
        "Root mean square of the distance from the reference, towards the tower or away from it.",
        number(3, "radial_rms_m"),
    ),
    Row("  total [m]", "The same in all three axes.", number(3, "tracking_rms_m")),
    Row(
        "largest slack [m], steps",
        "By how much a plan gave up the tightened clearance at most, and in how many controller "
        "steps it did: with margins, that is no violation yet.",
        _slack,
    ),
    Row(
        "solve time, median [ms]",
        "Time that a controller step takes.",
        number(2, "solve_ms", "median"),
    ),
    Row("  p99 [ms]", "99 of 100 steps take less.", number(2, "solve_ms", "p99")),
)
"""What is told of a flight."""
FLIGHT_WORDS = words_of(FLIGHT_ROWS) | MODE_WORDS


@explains(FLIGHT_WORDS)
def fly_command(
    mode: Annotated[
        str | None, option("|".join(MODES), "Mode of the controller.", "robust")
    ] = None,
    seed: Annotated[int, option("K", "Seed of gusts and of --sample.", "0")] = 0,
    duration: DurationOption = 50.0,
    zeta: Annotated[ZetaNumbers | None, option("9 NUMBERS", ZETA_HELP, "nine zeros")] = None,
    sample: Annotated[
        bool, typer.Option("--sample", help="Draw the true mismatch from its bounds by the seed.")
    ] = False,
    gust: Annotated[str, option("|".join(GUST_KINDS), "Gusts.", "ou")] = "ou",
    world: WorldOption = None,
    d_ref: DRefOption = None,
    vehicle: VehicleOption = None,
    controller: Annotated[str | None, CONTROLLER_OR_OWN] = None,
    scenario: Annotated[
        Path | None,
        option(
            "FILE.yaml",
            "A flight that gtmr attack or a report wrote, instead of all options above.",
        ),
    ] = None,
    out: Annotated[Path | None, option("FILE.npz", "Write the flight, row by row.")] = None,
    report: Annotated[
        bool,
        typer.Option("--report", help=f"Write {REPORT_FILE} beside --out, or into this folder."),
    ] = False,
    json: JsonOption = None,
) -> None:
    """Fly one closed loop in this process, without ROS."""
    require_duration(duration)
    require_seed(seed)
    if out is not None and out.suffix != ".npz":
        raise InputError(f"--out = {out}: expected a name that ends in .npz")
    require_new_file("--out", out)
    page = (out.parent if out is not None else Path()) / REPORT_FILE if report else None
    require_new_file("--report", page)
    require_folder_of("--json", json)
    if scenario is not None:
        others = (mode, zeta, world, d_ref, vehicle, sample or None)
        usual = (seed, duration, gust) == (0, 50.0, "ou")
        own = None if controller is None else OwnController.named("--controller", controller)
        of_a_file = controller is not None and own is None
        if not usual or of_a_file or any(other is not None for other in others):
            raise InputError(
                f"--scenario = {scenario}: says it all; leave out the rest, but for the file of a "
                "controller of your own"
            )
        again = ScenarioFile.from_yaml(scenario)
        pilot = _pilot(again, scenario, own)
        period_s = again.controller.sampling_time_s
        named = f"--scenario = {scenario}"
        log = _flown(named, again.scenario, pilot, again.duration_s, period_s)
        _tell(log, str(scenario), out, page, json)
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
    flight = scenario_for(config, own.name if own else mode, met, gust, seed, zeta)
    if sample:
        flight = flight.sampled()
    flown: StepController
    flown = Controller(config, mode) if own is None else own.make(config)  # type: ignore[arg-type]
    period_s = config.sampling_time_s
    log = _flown(f"--controller = {controller or told}", flight, flown, duration, period_s)
    _tell(log, world or "paper", out, page, json)


def _pilot(flown: ScenarioFile, path: Path, own: OwnController | None) -> StepController:
    """Make the controller that flew what is in a file."""
    # Only here: what flies in the arena takes long to import.
    from gtmr_study.rivals.catalogue import RIVALS

    if own is not None:
        if own.name != flown.mode:
            raise InputError(f"--controller = {own.path}:{own.name}: {path} is of {flown.mode}")
        return own.make(flown.controller)
    if flown.mode not in RIVALS:
        raise InputError(
            f"--scenario = {path}: mode = {flown.mode!r} is none of {', '.join(RIVALS)}; name its "
            f"file: --controller file.py:{flown.mode}"
        )
    return RIVALS[flown.mode].make(flown.controller, flown.scenario)


def scenario_for(
    config: ControllerConfig,
    mode: str,
    world: World,
    gust: str,
    seed: int,
    zeta: tuple[float, ...] | None,
) -> Scenario:
    """Make the scenario in which a controller is right about all but zeta, gusts and world.

    Raises ConfigError if zeta is outside its bounds, or the worst gusts against it are not known.
    """
    sequence = worst_gusts(config, mode) if gust == "l1" else None
    return Scenario.parse(
        {
            "vehicle": config.vehicle,
            "tower": config.tower,
            "helix": config.helix,
            "uncertainty": config.uncertainty,
            "gust": {"kind": gust, **({} if sequence is None else {"sequence": sequence})},
            "world": world,
            "seed": seed,
            **({} if zeta is None else {"zeta": zeta}),
        },
        "flight",
    )


def _flown(
    named: str,
    scenario: Scenario,
    pilot: StepController,
    duration_s: float,
    period_s: float,
) -> FlightLog:
    """Fly, with a progress bar; what the controller does wrong is bad input."""
    with progress() as bar:
        task = bar.add_task(f"{duration_s:g} s", total=round(duration_s / period_s))

        def show(step: int) -> None:
            bar.update(task, completed=step)

        try:
            return fly(scenario, pilot, duration_s, period_s, show)
        except FlightError as error:
            raise InputError(f"{named}: {error}") from None


def _tell(
    log: FlightLog, world: str, out: Path | None, page: Path | None, json: Path | None
) -> None:
    """Tell and write what came of a flight."""
    result = {**log.summary(), "world": world}
    if out is not None:
        content = io.BytesIO()
        log.save(content)
        write_whole(out, content.getvalue())
    if page is not None:
        write_log_report([(log, out or Path("flight.npz"))], page)
    print_rows(FLIGHT_ROWS, {log.mode: result})
    for name, path in (("Flight", out), ("Report", page)):
        if path is not None:
            console.print(f"{name}: {path}", highlight=False, markup=False, soft_wrap=True)
    write_json(json, result)


def write_log_report(logs: list[tuple[FlightLog, Path]], page: Path) -> list[Path]:
    """Write a report on flights and the files that they are in, or would be; give what it wrote.

    Raises BagError if it cannot be written.
    """
    from gtmr_monitor.flight import Flight
    from gtmr_monitor.report.page import write_report

    flights = [
        Flight.from_rows(
            vars(log),
            name=path.stem,
            mode=log.mode,
            tower=log.scenario.tower,
            helix=log.scenario.helix,
            vehicle=log.scenario.vehicle,
            gust=log.scenario.gust.kind,
            seed=log.scenario.seed,
            sampling_time_s=log.sampling_time_s,
            source=path,
        )
        for log, path in logs
    ]
    return write_report(flights, page)


def require_duration(duration: float) -> None:
    """Refuse a length of a flight [s] that is none."""
    if not 0.025 <= duration <= 86400.0:
        raise InputError(f"--duration = {duration:g}: allowed is 0.025 to 86400 s")
