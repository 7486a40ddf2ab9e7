# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Time of the active set against DAQP's on the same condensed QPs (docs/performance.md).

Run with ``python bench/active_set.py``; takes about two minutes. Ours is the whole feedback phase:
roll-out, condensing, active set, plan. DAQP's is what it says of itself, set-up (the factor of the
Hessian) and solution of a QP that is condensed already, stated as in `gtmr_nmpc.reference.qp`:
with hard clearance rows, and with slacks only where these do not suffice. It starts from nothing,
or from the rows active at the last step, moved on by a stage. Every time is the least of REPEATS.
"""

import time

import daqp
import numpy as np

from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_nmpc.reference.rti import Trajectory
from gtmr_study.rivals.bench import Situation, record_situations

STEPS = 400
"""Of each situation."""
REPEATS = 5
ACTIVE, LOWER = 1, 2
"""DAQP's marks of a row that it starts with, and of one at its lower bound."""
SOLVE = daqp.solve


class TimedDaqp:
    """Takes the place of `daqp.solve`, and adds up its times [s]."""

    def __init__(self, config: ControllerConfig, warm: bool) -> None:
        self._n, self._n_u, self._warm = config.horizon, config.vehicle.n_rotors, warm
        self.start()

    def start(self) -> None:
        """Forget the last step."""
        self._marks: dict[int, np.ndarray] = {}
        self.seconds = 0.0

    def __call__(self, hessian, gradient, rows, upper, lower, primal_tol):
        """Solve one QP; with slacks it has more variables than without, and a start of its own."""
        marks = self._marks.get(len(gradient), np.zeros(len(upper), np.int32))
        problem = (hessian, gradient, rows, upper, lower)
        results = [SOLVE(*problem, marks.copy(), primal_tol=primal_tol) for _ in range(REPEATS)]
        self.seconds += min(
            result[3]["setup_time"] + result[3]["solve_time"] for result in results
        )
        if self._warm:
            lam = self._moved_on(results[0][3]["lam"], len(gradient))
            self._marks[len(gradient)] = (ACTIVE * (lam != 0.0) + LOWER * (lam < 0.0)).astype(
                np.int32
            )
        return results[0]

    def _moved_on(self, lam, variables):
        """Multipliers one stage on: of inputs, slacks where there are any, speeds, clearances."""
        inputs = self._n * self._n_u
        parts = np.split(lam, np.cumsum([inputs, variables - inputs, inputs]))
        for part, width in zip(parts, (self._n_u, 1, self._n_u, 1), strict=True):
            part[:] = np.r_[part[width:], np.zeros(min(width, len(part)))]
        return np.concatenate(parts).astype(float)


def time_situation(situation: Situation) -> np.ndarray:
    """Time ours, DAQP cold and DAQP warm [s], one row a step."""
    config = ControllerConfig()
    compiled, same = CompiledIteration(config), InterpretedIteration(config)
    controller = Controller(config, iteration=compiled)
    rivals = [TimedDaqp(config, warm) for warm in (False, True)]
    feedback, times, last = compiled.feedback, [], np.inf
    seconds: list[float] = []
    state = np.zeros(0)

    def timed(x):
        nonlocal state
        state = x.copy()
        for _ in range(REPEATS):
            start = time.thread_time()
            plan = feedback(x)
            seconds.append(time.thread_time() - start)
        return plan

    compiled.feedback = timed
    for t, x in situation.steps:
        if t < last:
            controller.reset()
            same.cold(x)
            for rival in rivals:
                rival.start()
        last = t
        seconds.clear()
        solution = controller.step(t, x)
        row = [min(seconds)]
        same.prepare(t, solution.margin_scale)
        for rival in rivals:
            rival.seconds = 0.0
            daqp.solve = rival
            same.feedback(state)
            row.append(rival.seconds)
        times.append(row)
        same._last = Trajectory(solution.x_plan, solution.u_plan)
        same.warm(1)
    return np.array(times)


def main() -> None:
    """Print a line a situation: median, p99 and p99.9."""
    print(f"{'':14} {'ours [ms]':>22} {'DAQP cold / ours':>20} {'DAQP warm / ours':>20}")
    for situation in record_situations(STEPS):
        figures = 1e3 * np.percentile(time_situation(situation), (50, 99, 99.9), axis=0)
        ours = ", ".join(f"{value:.3f}" for value in figures[:, 0])
        cold, warm = (
            ", ".join(f"{ratio:.1f}" for ratio in figures[:, rival] / figures[:, 0])
            for rival in (1, 2)
        )
        print(f"{situation.name:14} {ours:>22} {cold:>20} {warm:>20}")


if __name__ == "__main__":
    main()
