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

import ctypes
import platform
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gtmr_nmpc import Controller, ControllerConfig, Mode
from gtmr_nmpc.config import TighteningOrder
from gtmr_study.solvers.daqp import DaqpRival
from gtmr_study.solvers.do_mpc import DoMpcRival
from gtmr_study.solvers.nlp import InspectionNlp, NlpSolution
from gtmr_study.solvers.piqp import PiqpRival
from gtmr_study.solvers.qp import QpRival
from gtmr_study.solvers.situations import WARM_UP_STEPS, Situation, in_flight, percentiles

Array = NDArray[np.float64]

CONTROLLERS: tuple[tuple[str, Mode, TighteningOrder], ...] = (
    ("nominal", "nominal", "frozen"),
    ("frozen", "robust", "frozen"),
    ("gradient", "robust", "gradient"),
    ("offset_free", "offset_free", "frozen"),
)
"""Name, mode and tightening of what is timed."""
TURNS = 5
"""How often each step is timed from Python and in C."""
Rivals = dict[str, InspectionNlp | DoMpcRival]
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


def time_controller(
    situation: Situation, mode: Mode, tightening: TighteningOrder
) -> dict[str, dict[str, float]]:
    """Time the controller on a situation.

    Median, p99, p99.9 and maximum [ms] of ``prepare``, ``feedback`` and ``step``, the last being
    the whole call from Python, in CPU time: on a shared machine other work does not count.
    """
    controller = Controller(ControllerConfig(tightening=tightening), mode)
    timings: dict[str, list[float]] = {"prepare": [], "feedback": [], "step": []}
    for t, x in in_flight(situation, controller.reset):
        start = time.thread_time()
        solution = controller.step(t, x)
        timings["step"].append(time.thread_time() - start)
        timings["prepare"].append(solution.timing.prepare_s)
        timings["feedback"].append(solution.timing.feedback_s)
    return {phase: percentiles(values[WARM_UP_STEPS:]) for phase, values in timings.items()}


def compare_with_c(
    situation: Situation, mode: Mode, tightening: TighteningOrder
) -> dict[str, dict[str, float]] | None:
    """Time the step from Python, ``python``, and the same one called in C, ``c``, in turns.

    Median, p99, p99.9 and maximum [ms] in CPU time, and ``ratio`` of the medians; of each step the
    least of several times counts. None where the step is not in C.
    """
    controller = Controller(ControllerConfig(tightening=tightening), mode)
    native = controller.native()
    if native is None:
        return None
    number, array = ctypes.c_double, ctypes.c_void_p
    in_c = ctypes.CFUNCTYPE(ctypes.c_int, array, number, array, number, array)(native.function)
    plan = np.empty(native.plan_length)
    to, memory = plan.ctypes.data, native.memory

    def seconds(call: Callable[[float, Array, int], Any]) -> list[float]:
        taken = []
        for t, x in in_flight(situation, controller.reset):
            address = x.ctypes.data
            start = time.thread_time()
            call(t, x, address)
            taken.append(time.thread_time() - start)
        return taken[WARM_UP_STEPS:]

    turns = [
        (
            seconds(lambda t, x, _: controller.step(t, x)),
            seconds(lambda t, _, address: in_c(memory, t, address, t, to)),
            # Refused, as no command acts before its state: what it costs to call and to time.
            seconds(lambda t, _, address: in_c(memory, t, address, t - 1.0, to)),
        )
        for _ in range(TURNS)
    ]
    python, c, call = np.min(turns, axis=0)
    figures = {"python": percentiles(python.tolist()), "c": percentiles((c - call).tolist())}
    figures["ratio"] = {"median": figures["python"]["median"] / figures["c"]["median"]}
    return figures


def time_rivals(situation: Situation, steps: int, rivals: Rivals) -> dict[str, dict[str, float]]:
    """Time general solvers, and the nominal controller beside them, on the same steps.

    In CPU time: what takes long is interrupted by other work on the machine, a short step is not.
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
        for t, x in in_flight(first, lambda: None):
            start = time.process_time()
            plan = nlp.solve(t, x, np.zeros(config.horizon + 1), plan)
            seconds.append(time.process_time() - start)
            costs[name].append(plan.cost)
        figures[name] = percentiles(seconds[1:])
    controller = Controller(config, "nominal")
    seconds, costs["gtmr"] = [], []
    for t, x in in_flight(first, controller.reset):
        start = time.process_time()
        solution = controller.step(t, x)
        seconds.append(time.process_time() - start)
        costs["gtmr"].append(ipopt.cost(t, solution.x_plan, solution.u_plan, solution.slack[1:]))
    figures["gtmr"] = percentiles(seconds[1:])
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


def make_qp_rivals(config: ControllerConfig) -> dict[str, QpRival]:
    """Make the QP solvers by name; PIQP is among them where it is installed."""
    rivals: dict[str, QpRival] = {"DAQP": DaqpRival(config)}
    with suppress(ModuleNotFoundError):
        rivals["PIQP"] = PiqpRival(config)
    return rivals


def machine() -> str:
    """Name the processor that the figures are from."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as info:  # noqa: PTH123
            names = [line.partition(":")[2].strip() for line in info if "model name" in line]
    except OSError:
        names = []
    return f"{names[0] if names else platform.processor()}, {len(names) or '?'} cores"
