# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command ``gtmr bench``."""

from typing import Annotated, Any

from rich.text import Text

from gtmr_nmpc import ControllerConfig
from gtmr_study.cli.tables import explains, new_table
from gtmr_study.cli.terminal import JsonOption, console, option
from gtmr_study.result_files import require_folder_of, write_json
from gtmr_study.solvers.bench import (
    CONTROLLERS,
    compare_with_c,
    machine,
    make_qp_rivals,
    make_rivals,
    time_controller,
    time_rivals,
)
from gtmr_study.solvers.qp import MODES, time_qp_rivals
from gtmr_study.solvers.situations import Situation, record_situations

COLUMNS = ("median", "p99", "p99.9")
WORDS = {
    "controller": "What is flown through, and below it which mode of the controller is timed.",
    "nominal": "The clearance as it is, eq. (5).",
    "frozen": "Mode robust, margins held within a step.",
    "gradient": "Mode robust, margins as functions of the plan, as eq. (15) reads.",
    "offset_free": "Mode offset_free: an observer, and margins of its loop.",
    "solver": "Likewise which general solver plans.",
    "median": "Half of the steps take less [ms].",
    "p99": "99 of 100 steps take less [ms].",
    "p99.9": "999 of 1000 steps take less [ms].",
    "max": "The longest step [ms].",
    "prepare": "Median of what is done before the state is known [ms].",
    "feedback": "Median of what is done from the state to the command [ms].",
    "to C": "Median relative to that of the same step called in C.",
    "ratio": "Median relative to that of the suite's nominal step.",
    "QP solver": "Likewise what solves the QP of that mode's steps, besides the suite.",
    "ratio p99": "The same of the 99th percentiles.",
    "difference": "The most that a first input differs from the suite's [Hz/s].",
    "gave up": "QPs that the solver did not solve.",
    "cost gap": "Cost of the solver's plan relative to that of the best one, minus 1.",
}
"""What the columns are."""


@explains(WORDS)
def bench_command(
    steps: Annotated[
        int, option("N", "Steps of the controller a situation.", "4000", min=100)
    ] = 4000,
    rival_steps: Annotated[
        int, option("N", "Steps of general solvers a situation; 0: none.", "40", min=0)
    ] = 40,
    qp_steps: Annotated[
        int, option("N", "Steps of QP solvers a situation; 0: none.", "1000", min=0)
    ] = 1000,
    json: JsonOption = None,
) -> None:
    """Time a controller step, and what a user would pick instead, on the same states."""
    require_folder_of("--json", json)
    result: dict[str, Any] = {"machine": machine(), "steps": steps, "controller": {}, "rivals": {}}
    result["in_c"] = {}
    result |= {"qp_steps": qp_steps, "rival_steps": rival_steps, "qp": {}}
    situations = record_situations(steps)
    table = new_table("controller", *COLUMNS, "prepare", "feedback", "to C", "ratio")
    for situation in situations:
        figures = {name: time_controller(situation, m, t) for name, m, t in CONTROLLERS}
        result["controller"][situation.name] = figures
        in_c = {name: compare_with_c(situation, m, t) for name, m, t in CONTROLLERS}
        result["in_c"][situation.name] = in_c
        nominal = figures["nominal"]["step"]["median"]
        table.add_row(Text(situation.name))
        for name, phases in figures.items():
            compared = in_c[name]
            table.add_row(
                Text(f"  {name}"),
                *(f"{phases['step'][column]:.3f}" for column in COLUMNS),
                f"{phases['prepare']['median']:.3f}",
                f"{phases['feedback']['median']:.3f}",
                "" if compared is None else f"{compared['ratio']['median']:.2f}",
                f"{phases['step']['median'] / nominal:.2f}",
            )
    console.print(result["machine"])
    console.print("Step of the controller, called from Python, CPU time [ms]", markup=False)
    console.print(table)
    if qp_steps:
        result["qp"] = _qp_solvers(situations, qp_steps)
    if rival_steps:
        rivals = new_table("solver", "median", "max", "ratio", "cost gap")
        contenders = make_rivals(ControllerConfig())
        for situation in situations:
            rival_figures = time_rivals(situation, rival_steps, contenders)
            result["rivals"][situation.name] = rival_figures
            rivals.add_row(Text(situation.name))
            for name, figure in rival_figures.items():
                rivals.add_row(
                    Text(f"  {name}"),
                    f"{figure['median']:.3f}",
                    f"{figure['max']:.3f}",
                    f"{figure['ratio']:.0f}",
                    f"{figure['cost_gap']:.1e}",
                )
        console.print("Nominal step of general solvers, CPU time [ms]", markup=False)
        console.print(rivals)
    write_json(json, result)


def _qp_solvers(situations: list[Situation], steps: int) -> dict[str, Any]:
    """Time QP solvers, and print a table of them; by mode, situation and solver."""
    table = new_table(
        "QP solver", "median", "p99", "max", "ratio", "ratio p99", "difference", "gave up"
    )
    told: dict[str, Any] = {}
    rivals = make_qp_rivals(ControllerConfig())
    for mode in MODES:
        told[mode] = {}
        for situation in situations:
            figures = time_qp_rivals(situation, mode, steps, rivals)
            told[mode][situation.name] = figures
            table.add_row(Text(f"{situation.name}, {mode}"))
            for name, figure in figures.items():
                table.add_row(
                    Text(f"  {name}"),
                    *(f"{figure[column]:.3f}" for column in ("median", "p99", "max")),
                    f"{figure['ratio']:.1f}",
                    f"{figure['ratio p99']:.1f}",
                    *(f"{figure[column]:.1g}" if column in figure else ""
                      for column in ("difference", "gave up")),
                )  # fmt: skip
    console.print("The QP alone by QP solvers, and the whole step of gtmr [ms]", markup=False)
    console.print(table)
    return told
