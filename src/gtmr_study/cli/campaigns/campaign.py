# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Commands of the Monte-Carlo studies: ``gtmr campaign``, ``reproduce``, ``calibrate``."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import MofNCompleteColumn, TaskID

from gtmr_model import CHANNELS
from gtmr_sim import GUST_KINDS
from gtmr_study.campaign.plans import PLAN_KINDS
from gtmr_study.campaign.study import Study, at_distance
from gtmr_study.cli.tables import MODE_WORDS, Row, explains, number, print_rows, words_of
from gtmr_study.cli.terminal import (
    CONTROLLER_OR_OWN,
    DRefOption,
    DurationOption,
    JsonOption,
    WorldOption,
    complain,
    console,
    option,
    progress,
    require_seed,
)
from gtmr_study.own_controller import OwnController
from gtmr_study.result_files import InputError, require_folder, require_folder_of, write_json

PAPER_SCENARIO = "paper"
"""Preset of the paper's study."""

SUMMARY_ROWS = (
    Row(
        "trials with violation",
        "In how many trials the clearance was ever below d_min, of how many.",
        lambda s: f"{s['violations']}/{s['trials']}",
    ),
    Row(
        "least clearance [m]",
        "Least distance of the vehicle's centre from the tower's surface in any trial, at the "
        "controller's sampling times.",
        number(3, "min_clearance_m"),
    ),
    Row(
        "  of every plant step [m]",
        "The same at every step of the simulation, which are finer.",
        number(3, "min_clearance_any_time_m"),
    ),
    Row(
        "median clearance [m]",
        "Half of all instants of all trials were closer.",
        number(3, "median_clearance_m"),
    ),
    Row(
        "residual, largest [m]",
        "The residual is s = d_min - clearance: above 0 is a violation.",
        number(3, "residual_m", "max"),
    ),
    Row(
        "  upper quartile [m]",
        "Three quarters of all instants were below this.",
        number(3, "residual_m", "q3"),
    ),
    Row(
        "  median [m]", "Half of all instants were below this.", number(3, "residual_m", "median")
    ),
    Row(
        "  lower quartile [m]",
        "A quarter of all instants was below this.",
        number(3, "residual_m", "q1"),
    ),
    Row(
        "  smallest [m]",
        "Farthest from the tower.",
        number(3, "residual_m", "min"),
    ),
    Row(
        "tracking error, radial [m]",
        "Root mean square of the distance from the reference, towards the tower or away from it.",
        number(3, "radial_rms_m"),
    ),
    Row(
        "solve time, mean [ms]",
        "Time that a controller step takes, with as many flights at once as there are workers.",
        number(2, "solve_ms", "mean"),
    ),
    Row("  p99 [ms]", "99 of 100 steps take less.", number(2, "solve_ms", "p99")),
)
"""What is told of a campaign."""
SUMMARY_WORDS = words_of(SUMMARY_ROWS) | MODE_WORDS

SeedOption = Annotated[int | None, option("K", "Seed.", "0")]
WorkersOption = Annotated[
    int | None,
    option(
        "W",
        "Threads on this machine; processes for a controller of your own.",
        "one per processor",
        min=1,
    ),
]
SchedulerOption = Annotated[
    str | None, option("ADDRESS", "A running Dask scheduler, as tcp://host:8786.")
]


@explains(SUMMARY_WORDS)
def campaign_command(
    out: Annotated[
        Path,
        option("DIR", "Folder of results: new, empty, or of the same campaign to go on with."),
    ],
    trials: Annotated[
        int | None, option("N", "Trials.", "500, or every point of the plan once")
    ] = None,
    seed: SeedOption = None,
    modes: Annotated[str | None, option("MODE,...", "Which modes fly.", "nominal,robust")] = None,
    duration: Annotated[float | None, option("S", "Length of a flight [s].", "50")] = None,
    plan: Annotated[
        str | None, option("|".join(PLAN_KINDS), "True mismatches to fly.", "random")
    ] = None,
    channels: Annotated[
        str | None, option("A,B", "Channels to vary: two for a grid, any for one-at-a-time.")
    ] = None,
    levels: Annotated[int | None, option("L", "Values of a varied channel.", "5")] = None,
    gust: Annotated[str | None, option("|".join(GUST_KINDS), "Gusts.", "ou")] = None,
    world: WorldOption = None,
    d_ref: DRefOption = None,
    controller: Annotated[str | None, CONTROLLER_OR_OWN] = None,
    scenario: Annotated[
        str | None,
        option(
            "NAME|YAML",
            "The study: a preset or a file; options win over it.",
        ),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    json: JsonOption = None,
) -> None:
    """Fly a Monte-Carlo campaign; started again after it was ended, it goes on."""
    require_one(workers, scheduler)
    require_seed(seed)
    require_folder("--out", out)
    require_folder_of("--json", json)
    own = None if controller is None else OwnController.named("--controller", controller)
    if own is not None and modes is not None:
        raise InputError(f"--modes = {modes}: {own.name} has no modes; leave it out")
    study = Study() if scenario is None else Study.load("scenario", scenario)
    varied = None if channels is None else channels.split(",")
    if plan == "grid" and varied is None and len(study.plan.channels) != 2:
        raise InputError(
            f"--plan = grid: needs --channels A,B as well, two of {', '.join(CHANNELS)}"
        )
    study = with_options(
        study,
        trials=trials,
        seed=seed,
        modes=None if modes is None else modes.split(","),
        duration_s=duration,
        controller=None if own else controller,
        plan={"kind": plan, "channels": varied, "levels": levels},
        gust={"kind": gust},
        world=world,
    )
    if d_ref is not None:
        study = with_options(study, controller=at_distance(study.controller, d_ref))
    for flown in study.flown_modes if own is None else (own.name,):
        # Before anything is written: there may be no worst gusts against what flies.
        study.against(flown)
    from gtmr_study.campaign.figures import Campaign, why_no_channels, write_figures
    from gtmr_study.campaign.run import fly_campaign

    with reported_progress() as show:
        summary = fly_campaign(study, out, workers, scheduler, partial(show, "flights"), own)
        write_figures(out)
    print_summary(summary)
    console.print(why_no_channels(Campaign.read(out)), soft_wrap=True)
    console.print(f"Results: {out}\nReport:  gtmr report {out}")
    write_json(json, summary)


@explains(SUMMARY_WORDS)
def reproduce_command(
    out: Annotated[
        Path,
        option("DIR", "Folder of results: new, empty, or of the same reproduction to go on with."),
    ] = Path("reproduction"),
    quick: Annotated[
        bool, typer.Option("--quick", help="24 trials instead of 500: about a minute.")
    ] = False,
    seed: SeedOption = None,
    scenario: Annotated[
        str, option("NAME|YAML", "The study: a preset or a file.", PAPER_SCENARIO)
    ] = PAPER_SCENARIO,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    json: JsonOption = None,
) -> None:
    """Reproduce the paper: 500 trials a mode, Table II, Fig. 1 and Fig. 2, and a report."""
    require_one(workers, scheduler)
    require_seed(seed)
    require_folder("--out", out)
    require_folder_of("--json", json)
    from gtmr_study.paper.reproduce import FULL, QUICK, REPORT_FILE, reproduce

    study = with_options(Study.load("scenario", scenario), seed=seed)
    command = f"gtmr reproduce{' --quick' if quick else ''} --seed {study.seed}"
    if scenario != PAPER_SCENARIO:
        command += f" --scenario {scenario}"
    effort = QUICK if quick else FULL
    with reported_progress() as show:
        results = reproduce(study, effort, out, workers, scheduler, show, command)
    print_summary(results["summary"])
    near = results["distance"]
    console.print(
        f"Distance to the paper's rows, in tolerances: nominal {near['nominal']:.2f}, "
        f"both {near['both']:.2f}\nReport:  {out / REPORT_FILE} (open it in a browser)"
    )
    write_json(json, results)


def calibrate_command(
    out: Annotated[Path, option("DIR", "Folder of a search: new, empty, or to go on with.")],
    target: Annotated[
        str, option("nominal|both", "Which rows of the paper to come close to.", "nominal")
    ] = "nominal",
    sets: Annotated[
        int | None,
        option(
            "N",
            "Sets of values in all, the shipped presets first.",
            "120, or 60 for both: some twelve minutes on two cores",
            min=1,
        ),
    ] = None,
    trials: Annotated[int, option("N", "Trials of a set.", "32", min=1)] = 32,
    duration: DurationOption = 50.0,
    seed: Annotated[int, option("K", "Seed of trials and search.", "0")] = 0,
    workers: WorkersOption = None,
    json: JsonOption = None,
) -> None:
    """Search what the paper leaves out for what comes closest to its results."""
    require_seed(seed)
    require_folder("--out", out)
    require_folder_of("--json", json)
    try:
        from gtmr_study.calibration import BEST, SETS, TARGETS, calibrate
    except ModuleNotFoundError as error:
        raise InputError(f"the search needs {error.name}: pip install {error.name}") from None
    if target not in TARGETS:
        raise InputError(f"--target = {target!r}: allowed is {', '.join(TARGETS)}")
    study = with_options(Study(), trials=trials, seed=seed, duration_s=duration)
    number = sets if sets is not None else SETS[target]
    with reported_progress() as show:
        show("sets", 0, number)
        result = calibrate(study, target, number, out, workers, partial(show, "sets"))
    for name, value in result["parameters"].items():
        console.print(f"{name}: {value:.4g}")
    rows = "nominal rows" if target == "nominal" else "rows, nominal and robust"
    presets = ", ".join(f"{name} {value:.3f}" for name, value in result["presets"].items())
    console.print(
        f"Distance of the best of {result['sets']} sets to the paper's {rows}: "
        f"{result['distance']:.3f} in {trials} trials of {duration:g} s ({presets})\n"
        f"The whole campaign with it:  gtmr reproduce --scenario {out / BEST}",
        soft_wrap=True,
    )
    write_json(json, result)


def with_options(study: Study, **changes: Any) -> Study:
    """Lay what the command line says over a study; ConfigError if a value is not allowed.

    None keeps what the study says, in a dict as well.
    """
    # What is left open stays so: the controller follows from the world.
    dump = study.model_dump()
    data = {name: dump[name] for name in study.model_fields_set}
    for name, value in changes.items():
        if isinstance(value, dict):
            given = {field: each for field, each in value.items() if each is not None}
            data[name] = dump[name] | given
        elif value is not None:
            data[name] = value
    return Study.parse(data, "campaign")


def print_summary(summary: dict[str, Any]) -> None:
    """Print the figures of a campaign, one column a mode."""
    flown = {mode: s for mode, s in summary.items() if s["trials"]}
    print_rows(SUMMARY_ROWS, flown)
    for mode, s in summary.items():
        if s["errors"]:
            complain(f"{mode}: {s['errors']} trials raised; their rows say why")


def require_one(workers: int | None, scheduler: str | None) -> None:
    """Refuse both workers here and those of a scheduler."""
    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler: give one of them")


@contextmanager
def reported_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show one progress bar for each thing done; a full disk ends the command with code 1."""
    bars: dict[str, TaskID] = {}
    try:
        with progress(MofNCompleteColumn()) as bar:

            def show(what: str, done: int, total: int) -> None:
                if what not in bars:
                    bars[what] = bar.add_task(what, total=total, completed=done)
                bar.update(bars[what], completed=done, total=total)

            yield show
    except OSError as error:
        complain(f"{error}; finished trials are kept: the same command goes on")
        raise typer.Exit(1) from None
