# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""Passes of the active set on hard random QPs (docs/solver.md).

Run with ``python bench/passes.py``; 10^6 QPs take about five minutes on two cores. Starts are
random in all that a state has: from inside the wall to a metre from the helix, at up to 2 m/s,
tilted by half a radian, rotors within their limits and beyond. Every start makes four QPs, of one
kind of margins: from a cold start; from the plan of the first, one step on; from that plan, moved
on by any number of stages, but at another random state, for which it is no good start; and one
step after it.
"""

import argparse
import os
import time
from collections import Counter
from collections.abc import Iterator
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np

from gtmr_model.dynamics import PITCH
from gtmr_nmpc import ControllerConfig
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.iteration import IterationResult
from gtmr_study.solvers.bench import machine

KINDS = (("nominal", 0.0, "frozen"), ("robust", 1.0, "frozen"), ("gradient", 1.0, "gradient"))
"""Name, margin scale, tightening."""
LOW = np.array([-0.45, -0.5, -0.5, -0.5, -0.5, -0.5, *[-2.0] * 6])
HIGH = np.array([1.0, 0.5, 0.5, 0.5, 0.5, 0.5, *[2.0] * 6])
"""Range of a start's offset from the helix, and of its speeds [m, rad, m/s, rad/s]."""
ROTORS_HZ = (0.0, 120.0)
"""Range of rotor speeds at a start; their limits are 16 and 100."""
NOISE = 0.02
"""What a state differs by from the plan's, times the range of starts [-]."""
QPS_A_START = 4
MAX_PASSES = 8 * 20 * 6
"""The bound, ``GTMR_MAX_PASSES`` of active_set.c, for 20 stages and 6 rotors."""
BIN = 50
"""Width of a bar of the histogram [passes]."""
REPEATS = 20
"""How often the longest QP is solved again to be timed; the least counts."""


class Qp(NamedTuple):
    """One QP that was solved."""

    passes: int
    guesses: int
    """Of what is at the rotors' bounds; -1 if none was right."""
    xi: np.ndarray
    """Measured rotor speeds [Hz], shape (N_p,)."""
    result: IterationResult
    feedback_s: float
    """Time of the feedback phase, of this thread [s]."""


class HardQps:
    """Hard random QPs of the default problem, the same for the same number of a start."""

    def __init__(self) -> None:
        self.config = ControllerConfig()
        self._problems = [ControllerConfig(tightening=kind[2]) for kind in KINDS]
        self._iteration = CompiledIteration(self.config)
        self._hover = self.config.helix.initial_state(self.config.tower, self.config.vehicle)
        tower = self.config.tower
        self._most_slack_m = tower.radius_m + tower.min_clearance_m

    def from_start(self, number: int) -> Iterator[Qp]:
        """Solve the QPs of a random start."""
        rng = np.random.default_rng(number)
        kind = number % len(KINDS)
        self._iteration.reconfigure(self._problems[kind])
        scale, t = KINDS[kind][1], rng.uniform(0.0, 12.0)
        x = self._random_state(rng)
        self._iteration.cold(x)
        yield (qp := self._solve(t, scale, x))
        for steps in (1, int(rng.integers(0, self.config.horizon)), 1):
            t += steps * self.config.sampling_time_s
            x = self._random_state(rng) if steps != 1 else self._near(rng, qp.result.x_plan[1])
            if self._is_sound(qp.result):
                self._iteration.warm(steps)
            else:
                self._iteration.cold(x)
            yield (qp := self._solve(t, scale, x))

    def _solve(self, t: float, scale: float, x: np.ndarray) -> Qp:
        self._iteration.prepare(t, scale)
        start = time.thread_time()
        result = self._iteration.feedback(x)
        feedback_s = time.thread_time() - start
        return Qp(self._iteration.passes, self._iteration.guesses, x[12:], result, feedback_s)

    def _random_state(self, rng: np.random.Generator) -> np.ndarray:
        x = self._hover.copy()
        x[:12] += rng.uniform(LOW, HIGH)
        x[12:] = rng.uniform(*ROTORS_HZ, len(x) - 12)
        return x

    def _near(self, rng: np.random.Generator, planned: np.ndarray) -> np.ndarray:
        x = planned.copy()
        x[:12] += NOISE * rng.uniform(LOW, HIGH)
        return x

    def _is_sound(self, result: IterationResult) -> bool:
        """As the controller judges a plan to start from."""
        upright = np.abs(result.x_plan[:, PITCH]).max() < np.pi / 2
        return bool(
            result.status != "failed" and upright and result.slack.max() <= self._most_slack_m
        )


class Tally(NamedTuple):
    """What some QPs took."""

    passes: np.ndarray
    """How many QPs were solved in so many passes, from 0 on."""
    guesses: Counter
    """How many QPs were solved in so many guesses; -1 are those that were left to their rows."""
    statuses: Counter
    """How many QPs ended with a status; of those that were not solved, how many at the bound, and
    how many with a plan that stays upright."""
    longest: tuple[float, int, int]
    """Passes of the longest that was solved, number of its start, and which of its QPs it is."""
    upright: tuple[float, int, int]
    """The same of those alone whose plan stays below a pitch of 90 degrees."""
    slowest: tuple[float, int, int]
    """The same of the slowest at the bound, with its time [s]; time 0 if there is none."""

    def plus(self, other: "Tally") -> "Tally":
        """Add up."""
        counts = np.zeros(max(len(self.passes), len(other.passes)), int)
        for part in (self.passes, other.passes):
            counts[: len(part)] += part
        return Tally(
            counts,
            self.guesses + other.guesses,
            self.statuses + other.statuses,
            max(self.longest, other.longest),
            max(self.upright, other.upright),
            max(self.slowest, other.slowest),
        )


def tally(starts: range) -> Tally:
    """Solve the QPs of these starts, in a process of their own."""
    qps, passes, guesses, statuses = HardQps(), [], Counter(), Counter()
    longest = upright = slowest = (0.0, 0, 0)
    for number in starts:
        for which, qp in enumerate(qps.from_start(number)):
            statuses[qp.result.status] += 1
            stays_upright = np.abs(qp.result.x_plan[:, PITCH]).max() < np.pi / 2
            if qp.result.status in ("solved", "softened"):
                passes.append(qp.passes)
                guesses[qp.guesses] += 1
                longest = max(longest, (qp.passes, number, which))
                if stays_upright:
                    upright = max(upright, (qp.passes, number, which))
                continue
            statuses["unsolved but upright"] += int(stays_upright)
            if qp.passes == MAX_PASSES:
                statuses["at the bound"] += 1
                slowest = max(slowest, (qp.feedback_s, number, which))
    return Tally(np.bincount(passes), guesses, statuses, longest, upright, slowest)


def percentile(counts: np.ndarray, share: float) -> int:
    """Find the passes that this share of the QPs, in percent, does not exceed."""
    return int(np.searchsorted(np.cumsum(counts), share / 100.0 * counts.sum()))


def describe(name: str, number: int, which: int) -> None:
    """Print what a QP is, and its time."""
    qps = HardQps()
    again = [list(qps.from_start(number))[which] for _ in range(REPEATS)]
    least = min(qp.feedback_s for qp in again)
    print(f"{name}: {again[0].passes} passes, start {number} ({KINDS[number % len(KINDS)][0]}), "
          f"QP {which}, feedback {1e6 * least:.0f} microseconds")  # fmt: skip


def main() -> None:
    """Print percentiles, a histogram, and the longest QP with its time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--qps", type=int, default=1_000_000)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    given = parser.parse_args()
    for name in ("qps", "workers"):
        if getattr(given, name) < 1:
            parser.error(f"--{name} {getattr(given, name)}: allowed is 1 or more")
    starts = -(-given.qps // QPS_A_START)
    parts = [range(first, min(first + 1000, starts)) for first in range(0, starts, 1000)]
    CompiledIteration(ControllerConfig())  # compiled before the workers ask for it
    with get_context("spawn").Pool(given.workers) as pool:
        tallies = list(pool.imap_unordered(tally, parts))
    total = tallies[0]
    for other in tallies[1:]:
        total = total.plus(other)
    counts = total.passes
    print(machine())
    print(f"{QPS_A_START * starts} QPs: {dict(total.statuses.most_common())}")
    print(f"passes of the {counts.sum()} that were solved:")
    for share in (50.0, 90.0, 99.0, 99.9, 99.99, 99.999, 100.0):
        print(f"{share:10.3f} %  {percentile(counts, share):4} passes")
    print(f"guesses of these, -1 where none was right: {dict(sorted(total.guesses.items()))}")
    for first in range(0, len(counts), BIN):
        if qps := counts[first : first + BIN].sum():
            print(f"{first:8} to {first + BIN - 1:<4} {qps:8} QPs")
    describe("longest that was solved", *total.longest[1:])
    describe("longest with an upright plan", *total.upright[1:])
    if total.slowest[0] > 0.0:
        describe("slowest at the bound", *total.slowest[1:])


if __name__ == "__main__":
    main()
