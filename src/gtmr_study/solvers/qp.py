# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The QPs that the controller solved, for general QP solvers.

Each solver gets them in the form that suits it, and tells its own time: what makes the QP, the
linearisation and for a dense solver the condensing, is not counted. Ours is the whole step.
"""

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gtmr_nmpc import Controller, ControllerConfig, Mode, Solution
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.reference.rti import Trajectory
from gtmr_study.solvers.situations import Situation, in_flight, percentiles

Array = NDArray[np.float64]

REPEATS = 3
"""Of every step and QP; the least time counts."""
MODES: tuple[Mode, ...] = ("nominal", "robust")
"""Whose QPs are solved: those without and with the paper's margins."""


@dataclass(frozen=True)
class RecordedStep:
    """A step of the controller, and what it linearised along."""

    mode: Mode
    """Which margins the clearance of its QP has."""
    t: float
    """Time of stage 0 [s]."""
    x: Array
    """Measured state, its yaw near the iterate's, shape (12 + N_p,)."""
    iterate: Trajectory
    """Where the QP was made."""
    solution: Solution
    """What the controller planned."""
    starts: bool
    """Whether a flight begins with it."""
    seconds: float
    """Time of the whole step, called from Python."""


class QpRival(Protocol):
    """A QP solver."""

    def start(self) -> None:
        """Forget the last step, where a flight starts anew."""
        ...

    def solve(self, step: RecordedStep) -> tuple[Array, float]:
        """Solve the QP of a step: the first input [Hz/s], shape (N_p,), and the time taken [s].

        RuntimeError if the solver gave up.
        """
        ...


def time_qp_rivals(
    situation: Situation, mode: Mode, steps: int, rivals: dict[str, QpRival]
) -> dict[str, dict[str, float]]:
    """Time QP solvers on the first QPs of a situation, and the controller's whole step.

    By contender: median, p99, p99.9 and maximum [ms], and ``ratio`` and ``ratio p99``, to the
    controller's; ``difference``, the largest of any first input to the controller's [Hz/s], and
    ``gave up``, how many QPs the solver did not solve.
    """
    config = ControllerConfig()
    recorded = record_steps(Situation(situation.name, situation.steps[:steps]), config, mode)
    figures = {"gtmr": percentiles([step.seconds for step in recorded[1:] or recorded])}
    for name, rival in rivals.items():
        seconds, difference, gave_up = [], 0.0, 0
        for step in recorded:
            if step.starts:
                rival.start()
            try:
                u, taken_s = rival.solve(step)
            except RuntimeError:
                gave_up += 1
                continue
            seconds.append(taken_s)
            difference = max(difference, float(np.abs(u - step.solution.u).max()))
        figures[name] = percentiles(seconds[1:] or seconds or [np.nan])
        figures[name] |= {"difference": difference, "gave up": float(gave_up)}
    ours = figures["gtmr"]
    for figure in figures.values():
        figure["ratio"] = figure["median"] / ours["median"]
        figure["ratio p99"] = figure["p99"] / ours["p99"]
    return figures


def record_steps(situation: Situation, config: ControllerConfig, mode: Mode) -> list[RecordedStep]:
    """Make the steps of a situation; each is timed as often as a rival's."""
    passes = [_steps(situation, config, mode) for _ in range(REPEATS)]
    least = np.min([seconds for _, seconds in passes], axis=0).tolist()
    return [
        RecordedStep(mode, *given, seconds)
        for given, seconds in zip(passes[0][0], least, strict=True)
    ]


def _steps(
    situation: Situation, config: ControllerConfig, mode: Mode
) -> tuple[list[tuple[float, Array, Trajectory, Solution, bool]], list[float]]:
    iteration = CompiledIteration(config)
    controller = Controller(config, mode, iteration)
    steps, seconds = [], []
    starts = False

    def begin() -> None:
        nonlocal starts
        controller.reset()
        starts = True

    for t, x in in_flight(situation, begin):
        start = time.perf_counter()
        solution = controller.step(t, x)
        seconds.append(time.perf_counter() - start)
        at = iteration.linearised()
        # Stage 0 of a plan is the measured state, its yaw near that of the iterate.
        steps.append((t, solution.x_plan[0], Trajectory(at.x, at.u), solution, starts))
        starts = False
    return steps, seconds
