# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Controller and guard as C99 for use without Python: sources, parameters, build, replay."""

import math
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gtmr_model import ConfigError
from gtmr_nmpc import Controller, ControllerConfig, Mode
from gtmr_nmpc.closed_loop import deviations
from gtmr_nmpc.compiled import codegen
from gtmr_nmpc.compiled.iteration import CompiledIteration, CParameters, parameters
from gtmr_nmpc.compiled.stepper import margin_table
from gtmr_nmpc.margins import ClosedLoopMargin, PaperMargin
from gtmr_sim import Scenario, Simulation
from gtmr_sim.worlds.motors import Motors
from gtmr_sim.worlds.world import World
from gtmr_study.export.guard import guard_files

FLIGHT_S = 10.0
"""Length of the recorded flight that the replay is checked against [s]."""
TOO_CLOSE_M = 0.25
"""By how much this flight starts closer to the tower than its helix [m]."""
FILES = ("replay.c", "CMakeLists.txt")
"""Written as they stand in this folder."""


def export_c(config: ControllerConfig, mode: Mode, folder: Path) -> list[Path]:
    """Write controller and guard as C99 with all that is needed to build and check them.

    CompileError if there is no C compiler to record the flight with, ConfigError if the margin is
    not the paper's.
    """
    if not isinstance(config.margin, PaperMargin):
        raise ConfigError(f"margin = {config.margin.kind!r}: in C there is the paper's alone")
    own = files("gtmr_study.export")
    contents = codegen.c_sources(config) | guard_files(config)
    contents |= {
        "parameters.h": _parameters_header(config),
        "flight.csv": _flight(config, mode),
        "offset_free.csv": _flight(config, "offset_free"),
        **{name: (own / name).read_text(encoding="utf-8") for name in FILES},
    }
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, text in contents.items():
        path = folder / name
        path.write_text(text, encoding="utf-8")
        written.append(path)
    return written


def _fields(config: ControllerConfig) -> str:
    values = parameters(config, observes=True)
    return ",\n".join(
        f"    /* {name} */ {_literal(getattr(values, name))}" for name, _ in CParameters._fields_
    )


def _offset_free_margins(config: ControllerConfig) -> NDArray[np.float64]:
    """Table of `gtmr_set_margins` for ``offset_free``."""
    margin = config.offset_free.margin
    if not isinstance(margin, ClosedLoopMargin):
        raise ConfigError(
            f"offset_free.margin = {margin.kind!r}: in C there is 'closed-loop' alone"
        )
    return margin_table(margin.by_steps(config, deviations(config)))


def _parameters_header(config: ControllerConfig) -> str:
    weights = config.offset_free.weights
    offset_free = config.model_copy(update={"weights": weights, "tightening": "frozen"})
    margins = _offset_free_margins(config)
    rows = ",\n".join(
        f"    {{{_literal(alpha_p)},\n     {_literal(alpha_g)}}}" for alpha_p, alpha_g in margins
    )
    iteration = CompiledIteration(config)
    memory, plan = iteration.sizes
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
/* Where in a plan the setpoints of the rotors begin. */
#define GTMR_SETPOINTS {iteration.parts["setpoints_hz"][0]}

static const gtmr_parameters gtmr_problem = {{
{_fields(config)}
}};

/* The mode offset_free: its own weights, and its table for gtmr_set_margins [m]. */
#define GTMR_MARGIN_ROWS {len(margins)}

static const gtmr_parameters gtmr_offset_free_problem = {{
{_fields(offset_free)}
}};

static const double gtmr_margins[GTMR_MARGIN_ROWS][2][GTMR_STAGES + 1] = {{
{rows}
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
    lag_s = config.motor_lag_s
    zeta = (*(0.0,) * 6, *(0.7 * bound for bound in config.uncertainty.wind_bias_n))
    scenario = Scenario(
        vehicle=config.vehicle,
        tower=config.tower,
        helix=config.helix,
        uncertainty=config.uncertainty,
        zeta=zeta,
        guard="hold",
        world=World(motors=Motors(lag_s=lag_s) if lag_s > 0.0 else None),
    )
    simulation = Simulation(scenario, config.sampling_time_s)
    start = simulation.x
    start[:2] *= 1.0 - TOO_CLOSE_M / np.hypot(*start[:2])
    simulation.plant.x = start
    controller = Controller(config, mode, CompiledIteration(config))
    rows, states = [], []
    # A stated delay counts in whole steps: the state is as old as that.
    late = math.ceil(config.delay_s / config.sampling_time_s - 1e-9)
    for _ in range(round(FLIGHT_S / config.sampling_time_s)):
        now = simulation.time_s
        states.append((now, simulation.x))
        t, x = states[max(0, len(states) - 1 - late)]
        solution = controller.step(t, x, now)
        commands = (*solution.u, *solution.setpoints_hz[1])
        values = (t, now, solution.margin_scale, *x, *commands)
        rows.append(",".join(repr(float(v)) for v in values))
        simulation.command(now, solution.u_plan, solution.setpoints_hz)
        simulation.advance(config.sampling_time_s)
    return "\n".join(rows) + "\n"
