# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The controller as plain C99, for use without Python: sources, parameters, a build, a replay."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gtmr_nmpc import Controller, ControllerConfig, Mode
from gtmr_nmpc.compiled import codegen
from gtmr_nmpc.compiled.iteration import CompiledIteration, CParameters, parameters
from gtmr_sim import Scenario, Simulation

FLIGHT_S = 10.0
"""Length of the recorded flight that the replay is checked against [s]."""
TOO_CLOSE_M = 0.25
"""By how much this flight starts closer to the tower than its helix [m]."""

CMAKE = """\
cmake_minimum_required(VERSION 3.16)
project(gtmr C)
set(CMAKE_C_STANDARD 99)
set(CMAKE_C_STANDARD_REQUIRED ON)
set(CMAKE_C_EXTENSIONS OFF)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()
add_compile_options(-Wall -Wextra -Werror -pedantic)

add_library(gtmr STATIC
  {sources})
target_include_directories(gtmr PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
target_link_libraries(gtmr PUBLIC m)

add_executable(replay replay.c)
target_link_libraries(replay gtmr)
enable_testing()
add_test(NAME replay COMMAND replay ${{CMAKE_CURRENT_SOURCE_DIR}}/flight.csv)
"""

REPLAY = r"""
/* Replays flight.csv and compares the commands with those that were recorded in it. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "gtmr.h"
#include "parameters.h"

#define N_X (12 + GTMR_ROTORS)
#define COLUMNS (2 + N_X + GTMR_ROTORS)
/* Hz/s */
#define TOLERANCE 1e-9

static unsigned char memory[GTMR_MEMORY_BYTES + 64];
static double plan[GTMR_PLAN_LENGTH];

static int read_row(FILE *file, double *row)
{
    int column;
    for (column = 0; column < COLUMNS; column++)
        if (fscanf(file, column == 0 ? "%lf" : ",%lf", &row[column]) != 1)
            return 0;
    return 1;
}

int main(int argc, char **argv)
{
    /* t, margin_scale, x, u */
    double row[COLUMNS], worst = 0.0;
    const double *x = row + 2, *u = x + N_X;
    int steps = 0, rotor;
    gtmr_controller *controller;
    FILE *file = argc == 2 ? fopen(argv[1], "r") : NULL;

    if (file == NULL) {
        fprintf(stderr, "usage: replay flight.csv\n");
        return 2;
    }
    if (gtmr_size() > GTMR_MEMORY_BYTES) {
        fprintf(stderr, "GTMR_MEMORY_BYTES: at least %lu\n", (unsigned long)gtmr_size());
        return 2;
    }
    controller = gtmr_create(memory + (64 - (uintptr_t)memory % 64) % 64, &gtmr_problem);
    for (; read_row(file, row); steps++) {
        if (steps == 0)
            gtmr_cold(controller, x);
        else
            gtmr_warm(controller, 1);
        gtmr_prepare(controller, row[0], row[1]);
        gtmr_feedback(controller, x, plan);
        for (rotor = 0; rotor < GTMR_ROTORS; rotor++) {
            const double *planned = plan + (GTMR_STAGES + 1) * N_X;
            worst = fmax(worst, fabs(planned[rotor] - u[rotor]));
        }
    }
    fclose(file);
    printf("%d steps, largest difference of a command %g Hz/s\n", steps, worst);
    return steps > 0 && worst <= TOLERANCE ? EXIT_SUCCESS : EXIT_FAILURE;
}
"""


def export_c(config: ControllerConfig, mode: Mode, folder: Path) -> list[Path]:
    """Write the controller as C99 with all that is needed to build and check it.

    Returns
    -------
    list of pathlib.Path
        The files.

    Raises
    ------
    CompileError
        If there is no C compiler to record the flight with.
    """
    sources = codegen.c_sources(config)
    units = sorted(name for name in sources if name.endswith(".c"))
    contents = sources | {
        "parameters.h": _parameters_header(config),
        "replay.c": REPLAY.lstrip(),
        "flight.csv": _flight(config, mode),
        "CMakeLists.txt": CMAKE.format(sources="\n  ".join(units)),
    }
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, text in contents.items():
        path = folder / name
        path.write_text(text, encoding="utf-8")
        written.append(path)
    return written


def _parameters_header(config: ControllerConfig) -> str:
    values = parameters(config)
    fields = ",\n".join(
        f"    /* {name} */ {_literal(getattr(values, name))}" for name, _ in CParameters._fields_
    )
    memory, plan = CompiledIteration(config).sizes
    return f"""\
/* Generated: the numbers of one problem; gtmr.h says what they are. */
#ifndef GTMR_PARAMETERS_H
#define GTMR_PARAMETERS_H

#include "gtmr.h"

#define GTMR_STAGES {config.horizon}
#define GTMR_ROTORS {config.vehicle.n_rotors}
/* Enough for vector registers of any width; gtmr_size() says how much it is with this compiler. */
#define GTMR_MEMORY_BYTES {memory + memory // 2}
#define GTMR_PLAN_LENGTH {plan}

static const gtmr_parameters gtmr_problem = {{
{fields}
}};

#endif
"""


def _literal(value: object) -> str:
    if isinstance(value, float):
        return repr(value)
    return "{" + ", ".join(repr(float(entry)) for entry in np.asarray(value)) + "}"


def _flight(config: ControllerConfig, mode: Mode) -> str:
    """Record a flight from a start too close to the tower, under wind towards it.

    Rotor limits, clearance and slacks are active in it, at first all of them.
    """
    zeta = (*(0.0,) * 6, *(0.7 * bound for bound in config.uncertainty.wind_bias_n))
    scenario = Scenario(
        vehicle=config.vehicle,
        tower=config.tower,
        helix=config.helix,
        uncertainty=config.uncertainty,
        zeta=zeta,
    )
    simulation = Simulation(scenario, config.sampling_time_s)
    start = simulation.x
    start[:2] *= 1.0 - TOO_CLOSE_M / np.hypot(*start[:2])
    simulation.plant.x = start
    controller = Controller(config, mode, CompiledIteration(config))
    rows = []
    for _ in range(round(FLIGHT_S / config.sampling_time_s)):
        t, x = simulation.time_s, simulation.x
        solution = controller.step(t, x)
        rows.append(",".join(repr(float(v)) for v in (t, solution.margin_scale, *x, *solution.u)))
        simulation.command(t, solution.u_plan)
        simulation.advance(config.sampling_time_s)
    return "\n".join(rows) + "\n"
