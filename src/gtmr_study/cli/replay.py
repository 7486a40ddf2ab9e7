# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Commands that use a bag again: ``gtmr replay``, ``gtmr play`` and ``gtmr recover``."""

import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import Annotated, Any

import typer

from gtmr_model import Vehicle
from gtmr_monitor.bag.reader import DamagedBagWarning
from gtmr_monitor.bag.vehicles import read_recording
from gtmr_monitor.coverage import Coverage
from gtmr_nmpc import MODES, ControllerConfig
from gtmr_study.cli.tables import Row, explains, number, print_rows, words_of
from gtmr_study.cli.terminal import (
    JsonOption,
    complain,
    console,
    needs_ros,
    option,
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

RATES = (0.01, 100.0)
"""Least and greatest rate of a playback."""
MAX_WAIT_S = 3600.0
"""Longest wait for listeners [s]."""

REPLAY_ROWS = (
    Row(
        "largest margin [m]",
        "By how much the clearance was tightened at most.",
        lambda r: _metres(r["largest_margin_m"]),
    ),
    Row(
        "largest residual at plans' end [m]",
        "The residual is s = d_min - clearance: above 0 is a violation. This is the largest that "
        "plans foresee for where they end.",
        lambda r: _metres(r["largest_foreseen_residual_m"]),
    ),
    Row(
        "steps without a solution",
        "In how many steps the solver gave up.",
        lambda r: str(r.get("failed_steps", "-")),
    ),
    Row(
        "solve time, median [ms]",
        "Time that a controller step takes.",
        lambda r: number(2, "solve_ms", "median")(r) if "solve_ms" in r else "-",
    ),
    Row(
        "  p99 [ms]",
        "99 of 100 steps take less.",
        lambda r: number(2, "solve_ms", "p99")(r) if "solve_ms" in r else "-",
    ),
)
"""What is told of a replay."""
REPLAY_WORDS = words_of(REPLAY_ROWS) | {
    "recorded": "What the controller told that flew.",
    "replayed": "What the controller tells that was fed the recorded states now.",
}

BagArgument = Annotated[Path, typer.Argument(metavar="BAG", help="A bag folder or MCAP file.")]


@explains(REPLAY_WORDS)
def replay_command(
    bag: BagArgument,
    mode: Annotated[str | None, option("|".join(MODES), "Mode throughout.", "as recorded")] = None,
    odom: Annotated[str | None, option("TOPIC", "Odometry.", "odom")] = None,
    rotors: Annotated[str | None, option("TOPIC", "Rotor speeds.", "rotor_states")] = None,
    controller: Annotated[
        str | None,
        option("NAME|YAML", "Controller: a preset or a file.", "recorded parameters"),
    ] = None,
    vehicle: Annotated[
        str | None, option("NAME|YAML", "Vehicle: a preset or a file.", "as recorded")
    ] = None,
    report: Annotated[
        Path | None, option("FILE.html", "Compare margins and plans, recorded and replayed.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Feed a bag's odometry and rotor speeds to the controller again; compare its commands."""
    if mode is not None:
        require_choice("--mode", mode, MODES)
    require_new_file("--report", report)
    require_folder_of("--json", json)
    try:
        from gtmr_study.ros.replay import replay
    except ModuleNotFoundError as error:
        raise needs_ros("a replay", error) from None

    with damage_told():
        recording = read_recording(bag, odom, rotors)
    tell_coverage(recording.name, recording.coverage)
    with progress() as bar:
        # Known once the bag is looked through; at most one step an odometry message.
        task = bar.add_task("replay", total=len(recording.commands or recording.odometry))
        replayed = replay(
            recording,
            mode,  # type: ignore[arg-type]
            None if controller is None else ControllerConfig.load("controller", controller),
            None if vehicle is None else Vehicle.load("vehicle", vehicle),
            lambda done, total: bar.update(task, completed=done, total=total),
        )
    result = replayed.result()
    if replayed.guess:
        complain(f"warning: {bag}: {replayed.guess}")
    if report is not None:
        from gtmr_monitor.report.page import write_report

        write_report(replayed.flights(), report)
    _print_result(result)
    if report is not None:
        console.print(f"Report: {report}")
    write_json(json, result)


def play_command(
    bag: BagArgument,
    rate: Annotated[float, option("R", "How many times as fast as recorded.", "1")] = 1.0,
    loop: Annotated[bool, typer.Option(help="Begin again at the end, until Ctrl-C.")] = False,
    wait: Annotated[float, option("S", "How long to wait for listeners, at most [s].", "5")] = 5.0,
    everything: Annotated[
        bool,
        typer.Option(
            "--all", help="Every topic, for viewers; else odometry, rotor speeds and /clock."
        ),
    ] = False,
) -> None:
    """Publish a bag's messages with their own timing and /clock, without rosbag2."""
    low, high = RATES
    if not low <= rate <= high:
        raise InputError(f"--rate = {rate:g}: allowed is {low:g} to {high:g}")
    if not 0.0 <= wait <= MAX_WAIT_S:
        raise InputError(f"--wait = {wait:g}: allowed is 0 to {MAX_WAIT_S:g} s")
    try:
        from gtmr_study.ros.play import play, read_playlist
    except ModuleNotFoundError as error:
        raise needs_ros("playing a bag", error) from None

    with damage_told():
        playlist = read_playlist(bag, everything)
    console.print(
        f"Playing {', '.join(sorted(playlist.types))}: {playlist.duration_s:.1f} s at "
        f"{rate:g} times the recorded speed; Ctrl-C ends it."
    )
    # The usual end of a playback.
    stop = Event()
    before = signal.signal(signal.SIGINT, lambda *_: stop.set())
    try:
        with progress() as bar, warnings.catch_warnings():
            warnings.simplefilter("ignore", DamagedBagWarning)
            task = bar.add_task("play", total=playlist.duration_s)

            def show(into_s: float) -> None:
                bar.update(task, completed=into_s)

            notes = play(playlist, rate, loop, wait, show, stop)
    finally:
        signal.signal(signal.SIGINT, before)
    for note in notes:
        complain(note)


def recover_command(
    bag: BagArgument,
    out: Annotated[Path, option("DIR", "Folder of the whole bag; new or empty.")],
    json: JsonOption = None,
) -> None:
    """Make a whole bag of what is left of a damaged one."""
    from gtmr_monitor.recover import recover

    require_empty_folder("--out", out)
    require_folder_of("--json", json)
    with damage_told():
        recovered = recover(bag, out)
    for odom, coverage in recovered.coverage.items():
        tell_coverage(odom, coverage)
    write_json(json, recovered.result())
    console.print(f"{recovered.messages} messages: {out}", highlight=False, soft_wrap=True)


@contextmanager
def damage_told() -> Iterator[None]:
    """Turn Python's warning of a damaged bag into a line for the user."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DamagedBagWarning)
        yield
    for warning in caught:
        complain(f"warning: {warning.message}")


def tell_coverage(name: str, coverage: Coverage) -> None:
    """Warn, on stderr, of a flight that is not recorded whole."""
    if not coverage.whole:
        complain(f"warning: {name}: covers {coverage}")


def _print_result(result: dict[str, Any]) -> None:
    print_rows(REPLAY_ROWS, {who: result[who] for who in ("recorded", "replayed")})
    if result["samples"]:
        console.print(
            f"{result['mode']}: {result['samples']} commands compared; they differ by at most "
            f"{result['max_abs_command_difference']:.3g} {result['unit']}, at "
            f"{result['largest_difference_at_s']:.3f} s."
        )
    else:
        console.print(f"{result['mode']}: {result['steps']} steps, no command to compare with.")
    for note in result["notes"]:
        console.print(f"Note: {note}", soft_wrap=True, highlight=False, markup=False)


def _metres(value: float | None) -> str:
    return "not recorded" if value is None else f"{value:.3f}"
