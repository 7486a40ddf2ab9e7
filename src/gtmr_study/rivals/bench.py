# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Time per controller step, and what a user would pick instead on the same steps.

Every contender gets the same recorded states, in the same order, with its own warm start. The
controller is timed in all situations; general solvers, being slow, on the first steps of each.
"""

import platform
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gtmr_model import ConfigError
from gtmr_nmpc import Controller, ControllerConfig, Mode
from gtmr_nmpc.config import TighteningOrder
from gtmr_sim import GustConfig, Scenario, Simulation
from gtmr_study.paper.claims import FIG_1_ZETA
from gtmr_study.rivals.do_mpc import DoMpcRival
from gtmr_study.rivals.nlp import InspectionNlp, NlpSolution

Array = NDArray[np.float64]

CONTROLLERS: tuple[tuple[str, Mode, TighteningOrder], ...] = (
    ("nominal", "nominal", "frozen"),
    ("frozen", "robust", "frozen"),
    ("gradient", "robust", "gradient"),
    ("offset_free", "offset_free", "frozen"),
)
"""Name, mode and tightening of what is timed."""
Rivals = dict[str, InspectionNlp | DoMpcRival]
WARM_UP_STEPS = 20
"""Steps before timing starts, not counted."""
QUIET_SQP = {
    "print_time": False,
    "print_header": False,
    "print_iteration": False,
    "print_status": False,
    "error_on_fail": False,
    "expand": True,
}
IPOPT = "IPOPT"
RIVALS: dict[str, tuple[str, dict[str, Any], bool]] = {
    IPOPT: (
        "ipopt",
        {
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.tol": 1e-6,
            "ipopt.mu_init": 1e-4,
            "ipopt.warm_start_init_point": "yes",
            "print_time": False,
            "expand": True,
        },
        False,
    ),
    "sqpmethod + qpOASES": (
        "sqpmethod",
        {
            **QUIET_SQP,
            "qpsol": "qpoases",
            "qpsol_options": {"printLevel": "none", "error_on_fail": False},
            "max_iter": 1,
        },
        # qpOASES is dense: with the states eliminated it is ten times as fast.
        True,
    ),
}
"""CasADi solver, its options, and whether the states are eliminated: IPOPT to a tolerance of
1e-6, and one iteration of SQP, as real-time iteration makes it."""


@dataclass(frozen=True)
class Situation:
    """Recorded states that every contender is given."""

    name: str
    """What goes on."""
    steps: list[tuple[float, Array]]
    """Time [s] and state of each step; time falls back to zero where a flight starts anew."""


def record_situations(steps: int) -> list[Situation]:
    """Fly what the contenders are timed on.

    Calm flight; wind with gusts towards the tower, where the tightened clearance is active much of
    the time; starts from far off, where rotor limits and slacks are. No guard interferes.
    """
    windy = Scenario(zeta=FIG_1_ZETA, gust=GustConfig(kind="worst-case"), guard="hold")
    return [
        Situation(
            "calm", list(_flight(Scenario(gust=GustConfig(kind="none"), guard="hold"), steps))
        ),
        Situation("at the limit", list(_flight(windy, steps))),
        Situation("recovery", list(_recoveries(Scenario(guard="hold"), steps))),
    ]


def _flight(
    scenario: Scenario, steps: int, x0: Array | None = None
) -> Iterator[tuple[float, Array]]:
    simulation, controller = Simulation(scenario, 0.025), Controller()
    if x0 is not None:
        simulation.plant.x = x0
    for _ in range(steps):
        t, x = simulation.time_s, simulation.x
        yield t, x
        simulation.command(t, controller.step(t, x).u_plan)
        simulation.advance(0.025)


def _recoveries(scenario: Scenario, steps: int) -> Iterator[tuple[float, Array]]:
    """Short flights from random starts: off the helix, too close, at rest, rotors off hover."""
    rng = np.random.default_rng(0)
    start = scenario.helix.initial_state(scenario.tower, scenario.vehicle)
    for first in range(0, steps, 40):
        x = start.copy()
        x[:3] += rng.uniform([-0.25, -0.2, -0.2], [0.4, 0.2, 0.2])
        x[3:5] += rng.uniform(-0.2, 0.2, 2)
        x[6:9] = rng.uniform(-0.6, 0.6, 3) * (rng.random() < 0.7)
        x[12:] += rng.uniform(-25.0, 25.0, len(x) - 12)
        yield from _flight(scenario, min(40, steps - first), x)


def time_controller(
    situation: Situation, mode: Mode, tightening: TighteningOrder
) -> dict[str, dict[str, float]]:
    """Time the controller on a situation.

    Median, p99, p99.9 and maximum [ms] of ``prepare``, ``feedback`` and ``step``, the last being
    the whole call from Python.
    """
    controller = Controller(ControllerConfig(tightening=tightening), mode)
    timings: dict[str, list[float]] = {"prepare": [], "feedback": [], "step": []}
    for t, x in _in_flight(situation, controller.reset):
        start = time.perf_counter()
        solution = controller.step(t, x)
        timings["step"].append(time.perf_counter() - start)
        timings["prepare"].append(solution.timing.prepare_s)
        timings["feedback"].append(solution.timing.feedback_s)
    return {phase: _percentiles(values[WARM_UP_STEPS:]) for phase, values in timings.items()}


def time_rivals(situation: Situation, steps: int, rivals: Rivals) -> dict[str, dict[str, float]]:
    """Time general solvers, and the nominal controller beside them, on the same steps.

    By contender: median, p99, p99.9 and maximum of a step [ms], ``ratio`` of its median to the
    controller's, and ``cost_gap``, the median of |cost - cost of IPOPT| / cost of IPOPT.
    """
    config = ControllerConfig()
    first = Situation(situation.name, situation.steps[:steps])
    costs: dict[str, list[float]] = {}
    figures: dict[str, dict[str, float]] = {}
    ipopt = rivals[IPOPT]
    assert isinstance(ipopt, InspectionNlp)
    for name, nlp in rivals.items():
        seconds, costs[name] = [], []
        plan: NlpSolution | None = None
        for t, x in _in_flight(first, lambda: None):
            start = time.perf_counter()
            plan = nlp.solve(t, x, np.zeros(config.horizon + 1), plan)
            seconds.append(time.perf_counter() - start)
            costs[name].append(plan.cost)
        figures[name] = _percentiles(seconds[1:])
    controller = Controller(config, "nominal")
    seconds, costs["gtmr"] = [], []
    for t, x in _in_flight(first, controller.reset):
        start = time.perf_counter()
        solution = controller.step(t, x)
        seconds.append(time.perf_counter() - start)
        costs["gtmr"].append(ipopt.cost(t, solution.x_plan, solution.u_plan, solution.slack[1:]))
    figures["gtmr"] = _percentiles(seconds[1:])
    best = np.array(costs[IPOPT])
    for name, figure in figures.items():
        figure["ratio"] = figure["median"] / figures["gtmr"]["median"]
        figure["cost_gap"] = float(np.median(np.abs(np.array(costs[name]) - best) / best))
    return figures


def make_rivals(config: ControllerConfig) -> Rivals:
    """State the nominal problem for every general solver, by name; takes about a minute.

    do-mpc is among them where it is installed.
    """
    rivals: Rivals = {
        name: InspectionNlp(config, solver, options, condensed=condensed)
        for name, (solver, options, condensed) in RIVALS.items()
    }
    # No dependency: it is measured where somebody has installed it.
    with suppress(ModuleNotFoundError):
        rivals["do-mpc"] = DoMpcRival(config)
    return rivals


def _in_flight(situation: Situation, reset: Callable[[], None]) -> Iterator[tuple[float, Array]]:
    """Go through the states; where a flight starts anew, the warm start is dropped."""
    last = np.inf
    for t, x in situation.steps:
        if t < last:
            reset()
        last = t
        yield t, x


def _percentiles(seconds: list[float]) -> dict[str, float]:
    if not seconds:
        raise ConfigError(f"steps: allowed is more than {WARM_UP_STEPS}")
    quantiles = np.percentile(seconds, [50.0, 99.0, 99.9, 100.0])
    median, p99, p999, most = (1e3 * float(value) for value in quantiles)
    return {"median": median, "p99": p99, "p99.9": p999, "max": most}


def machine() -> str:
    """Name the processor that the figures are from."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as info:  # noqa: PTH123
            names = [line.partition(":")[2].strip() for line in info if "model name" in line]
    except OSError:
        names = []
    return f"{names[0] if names else platform.processor()}, {len(names) or '?'} cores"
