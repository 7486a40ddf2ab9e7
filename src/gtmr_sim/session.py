# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A flight as a state machine for other processes: it waits, flies, pauses, and ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_sim.scenario import Scenario
from gtmr_sim.simulation import Simulation

NANOSECONDS = 1_000_000_000
"""In a second."""
MAX_DELAY_NS = 60_000_000
"""Oldest plan that is taken, beyond the delay that the world states [ns]: with more delay in the
loop than is known of it is no longer stable. One that comes late is no loss, as the plan in play
goes on; if all do, that one ends, and the guard takes charge."""


class Session:
    """Decides when simulated time may go on; knows nothing of messages and clocks.

    A flight stands still at time zero until the first measurement is answered by a command. In
    lockstep it does so for every measurement; where none has arrived it goes on. A tick, by which
    :meth:`advance` flies on [s], is T_s in lockstep, else T_s or a whole part of it; a duration
    [s] of zero means that the flight never ends.
    """

    def __init__(
        self,
        simulation: Simulation,
        sampling_time_s: float,
        tick_s: float,
        lockstep: bool,
        duration_s: float,
    ) -> None:
        self._simulation = simulation
        self._sampling_ns = round(sampling_time_s * NANOSECONDS)
        self._tick_s = tick_s
        self._lockstep = lockstep
        self._duration_ns = round(duration_s * NANOSECONDS)
        self.paused = False
        """Whether time is stopped for now."""
        self._begin()

    def _begin(self) -> None:
        self._command_ns: int | None = None
        self._unanswered = False
        self._measure()
        self.missed_commands = 0
        """How many sampling times passed without a command for them."""

    def _measure(self) -> None:
        """Take in the newest measurement that has arrived by now, if there is one."""
        newest = self._simulation.measured()
        self.is_new = newest is not None
        """Whether a measurement has arrived since the last instant."""
        if newest is not None:
            self.measured_ns, self.measured_x = round(newest[0] * NANOSECONDS), newest[1]
            self._unanswered = True

    @property
    def delay_ns(self) -> int:
        """Age of a measurement when it arrives, at most, as the world states it [ns]."""
        return round(self._simulation.scenario.world.odometry.delay_s * NANOSECONDS)

    def reconfigure(self, scenario: Scenario) -> None:
        """Continue in another scenario."""
        self._simulation.reconfigure(scenario)

    def reset(self) -> None:
        """Go back to the start of the same flight, and wait for its first command."""
        self._simulation.reset()
        self._begin()

    @property
    def stamp_ns(self) -> int:
        """Simulated time [ns]."""
        return round(self._simulation.time_s * NANOSECONDS)

    @property
    def x(self) -> NDArray[np.float64]:
        """True state, shape (12 + N_p,)."""
        return self._simulation.x

    @property
    def started(self) -> bool:
        """Whether the first command has come."""
        return self._command_ns is not None

    @property
    def over(self) -> bool:
        """Whether the flight has lasted as long as it should."""
        return 0 < self._duration_ns <= self.stamp_ns

    @property
    def awaits_command(self) -> bool:
        """Whether time stands still because a command is missing."""
        return not self.started or (self._lockstep and self._unanswered)

    @property
    def ready(self) -> bool:
        """Whether time may go on."""
        return not (self.paused or self.over or self.awaits_command)

    @property
    def command_age_s(self) -> float:
        """How long ago the newest plan began, by its stamp; zero if it is still to come [s]."""
        return max(0, self.stamp_ns - (self._command_ns or 0)) / NANOSECONDS

    @property
    def usual_age_s(self) -> float:
        """How long ago a plan began at most, where none is missed [s]."""
        return (self._sampling_ns + self.delay_ns) / NANOSECONDS

    @property
    def guard_active(self) -> bool:
        """Whether the guard is in charge."""
        return self._simulation.guard_active

    @property
    def guard_cause(self) -> str:
        """Why the guard is in charge, one of `gtmr_guard.CAUSES`; empty if it is not."""
        return self._simulation.guard_cause

    @property
    def guard_time_s(self) -> float:
        """How long the guard has been in charge, since the start of the flight [s]."""
        return self._simulation.guard_time_s

    @property
    def plan_step(self) -> int:
        """Which input of the plan is being played, 0 while commands come in time."""
        return self._simulation.plan_index

    def command(
        self, stamp_ns: int, u_plan: ArrayLike, setpoints_hz: ArrayLike | None = None
    ) -> bool:
        """Take over a plan, one row every T_s, that acts from a stamp on [ns].

        It has accelerations [Hz/s], shape (N, N_p), and for a world with motors speed setpoints
        [Hz], shape (N + 1, N_p). Says whether it is taken: it must be newer than the plan before,
        begin no later than ``delay_ns`` from now, and no earlier than `MAX_DELAY_NS` and
        ``delay_ns`` ago, and not before time zero.
        """
        age_ns = self.stamp_ns - stamp_ns
        if not -self.delay_ns <= age_ns <= MAX_DELAY_NS + self.delay_ns or stamp_ns < 0:
            return False
        if self._command_ns is not None and stamp_ns <= self._command_ns:
            return False
        self._simulation.command(stamp_ns / NANOSECONDS, u_plan, setpoints_hz)
        self._command_ns = stamp_ns
        self._unanswered = self._unanswered and stamp_ns < self.measured_ns
        return True

    def advance(self) -> None:
        """Fly on by one tick; only when ready."""
        self._simulation.advance(self._tick_s)
        self._measure()
        at_sample = self.stamp_ns % self._sampling_ns == 0
        if at_sample and self.command_age_s > self.usual_age_s + 0.5e-9 * self._sampling_ns:
            self.missed_commands += 1
