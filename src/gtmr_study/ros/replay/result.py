# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a replay gave: its steps, their comparison with what was recorded, flights for a report."""

import math
from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gtmr_monitor.bag.flight import flight_of
from gtmr_monitor.bag.recording import Recording
from gtmr_monitor.flight import Flight, MarginHistory, Predictions
from gtmr_monitor.residual import solve_statistics
from gtmr_msgs_py.messages import path as plan_path
from gtmr_msgs_py.wire import stamps
from gtmr_nmpc import ControllerConfig, Mode

Array = NDArray[np.float64]

UNIT = "Hz/s"
"""Of commands, and of their differences."""


@dataclass(frozen=True)
class Step:
    """One step of the replayed controller, and what is compared with it."""

    stamp_ns: int
    """Stamp of its odometry [ns]."""
    mode: Mode
    """Of the controller."""
    rotor_source: str
    """Where the rotor speeds came from, see ``SOURCES``."""
    by_channel: Array
    """The terms of alpha_p, eq. (12) [m], shape (N + 1, 9)."""
    eps_s: Array
    """What of alpha_p belongs to no channel [m], shape (N + 1,)."""
    alpha_g: Array
    """Gust margin, eq. (13) [m], shape (N + 1,)."""
    slack: Array
    """Violation of the tightened clearance [m], shape (N + 1,)."""
    foreseen: float
    """Residual s at the end of the plan [m]."""
    failed: bool
    """Whether the QP solver gave up."""
    solve_s: float
    """Preparation and feedback, wall time [s]."""
    difference: float | None
    """Largest difference of a rotor acceleration anywhere in the plan from the recorded command
    [Hz/s]; None if no command was recorded that it could be compared with."""


@dataclass(frozen=True)
class Replay:
    """A recorded flight as the controller answers it now."""

    recording: Recording
    """What was fed to it."""
    config: ControllerConfig
    """The problem at the first step."""
    steps: list[Step]
    """In order; at least one."""
    guessed: dict[str, Any]
    """Controller parameters that the bag does not tell, and the defaults that were taken."""
    remarks: list[str]
    """What else a user should know, one sentence each."""

    @property
    def guess(self) -> str | None:
        """What was guessed of the parameters, in one sentence; None if nothing was."""
        if not self.guessed:
            return None
        taken = ", ".join(f"{name} = {value}" for name, value in self.guessed.items())
        return (
            f"{len(self.guessed)} parameters of {self.recording.node} are not in the bag; these "
            f"defaults are a guess: {taken}"
        )

    @property
    def notes(self) -> list[str]:
        """What a user should know, one sentence each."""
        return [*([self.guess] if self.guess else []), *self.remarks]

    @property
    def modes(self) -> tuple[tuple[float, Mode], ...]:
        """From when on [s], since the first odometry, which mode planned."""
        begins = self.steps[:1]
        begins += [step for before, step in pairwise(self.steps) if before.mode != step.mode]
        return tuple((self._since_start(step.stamp_ns), step.mode) for step in begins)

    @property
    def compared(self) -> list[Step]:
        """The steps that were compared with a recorded command."""
        return [step for step in self.steps if step.difference is not None]

    @cached_property
    def margins(self) -> MarginHistory:
        """The margins of the replayed controller."""
        steps = self.steps
        return MarginHistory(
            self._times(),
            np.array([step.by_channel for step in steps]),
            np.array([step.eps_s for step in steps]),
            np.array([step.alpha_g for step in steps]),
            np.array([step.slack for step in steps]),
        )

    @cached_property
    def flown(self) -> Flight:
        """The recorded flight, with what its controller foresaw.

        Raises BagError if recorded parameters make no tower or helix.
        """
        flown = replace(flight_of(self.recording), predictions=self._recorded_predictions())
        if self.recording.changes:
            return flown
        return replace(flown, tower=self.config.tower, helix=self.config.helix)

    def result(self) -> dict[str, Any]:
        """Sum up as plain data.

        ``samples`` commands were compared; ``max_abs_command_difference`` is over all rotor
        accelerations of all stages of their plans, in ``unit``; None without samples.
        ``largest_foreseen_residual_m`` is s at the end of the plans.
        """
        compared = self.compared
        worst = max(compared, key=lambda step: step.difference or 0.0, default=None)
        return {
            "bag": str(self.recording.path),
            "mode": " → ".join(mode for _, mode in self.modes),
            "modes": [{"from_s": at, "mode": mode} for at, mode in self.modes],
            "samples": len(compared),
            "max_abs_command_difference": None if worst is None else worst.difference,
            "unit": UNIT,
            "largest_difference_at_s": (
                None if worst is None else self._since_start(worst.stamp_ns)
            ),
            "steps": len(self.steps),
            "recorded": {
                "largest_margin_m": _largest(self.flown.margins.total),
                "largest_foreseen_residual_m": _largest(self._recorded_predictions().residual),
            },
            "replayed": {
                "largest_margin_m": _largest(self.margins.total),
                "largest_foreseen_residual_m": _largest(self._predictions().residual),
                "largest_slack_m": _largest(self.margins.slack),
                "failed_steps": sum(step.failed for step in self.steps),
                "solve_ms": solve_statistics([1e3 * step.solve_s for step in self.steps]),
            },
            "rotor_speeds": dict(Counter(step.rotor_source for step in self.steps)),
            "guessed_parameters": self.guessed,
            "late_messages": self.recording.late,
            "coverage": self.recording.coverage.as_json(),
            "guard_time_s": self.flown.guard_time_s,
            "notes": self.notes,
        }

    def flights(self) -> list[Flight]:
        """Give the recorded flight and the replayed one, for a report that compares them.

        The same motion twice; margins, predictions and solve times are each its own.
        """
        replayed = replace(
            self.flown,
            margins=self.margins,
            t_solve=self._times(),
            solve_ms=np.array([1e3 * step.solve_s for step in self.steps]),
            modes=self.modes,
            deadline_ms=1e3 * self.config.sampling_time_s,
            tower=self.config.tower,
            helix=self.config.helix,
            predictions=self._predictions(),
            replayed=True,
            notes=(self.guess,) if self.guess else (),
        )
        return [self.flown, replayed]

    def _predictions(self) -> Predictions:
        ahead_s = self.config.horizon * self.config.sampling_time_s
        return Predictions(
            self._times() + ahead_s, np.array([step.foreseen for step in self.steps])
        )

    def _recorded_predictions(self) -> Predictions:
        plans = [plan_path.decode(item.message) for item in self.recording.predicted_paths]
        ends = [(times_ns[-1], positions[-1]) for times_ns, positions in plans if len(times_ns)]
        return Predictions(
            np.array([self._since_start(int(time_ns)) for time_ns, _ in ends]),
            self.config.tower.residual(np.array([p for _, p in ends]).reshape(-1, 3)),
        )

    def _times(self) -> Array:
        return np.array([self._since_start(step.stamp_ns) for step in self.steps])

    def _since_start(self, time_ns: int) -> float:
        return stamps.seconds(time_ns - self.recording.start_ns)


def _largest(values: Array) -> float | None:
    """Largest number of all; None if there is none, or it is not finite and so no JSON."""
    largest = float(values.max(initial=-math.inf))
    return largest if math.isfinite(largest) else None
