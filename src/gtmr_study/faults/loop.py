# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The closed loop in process, as the nodes close it, with a fault between its two halves."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gtmr_model import Helix
from gtmr_model.dynamics import POSITION, ROTORS
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_msgs_py.wire.order import StampOrder
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.online.fitness import Fitness
from gtmr_nmpc.online.plausibility import Plausibility
from gtmr_nmpc.online.schedule import Due, Schedule
from gtmr_sim import Scenario, Simulation
from gtmr_sim.session import NANOSECONDS, Session
from gtmr_study.faults.fault import Outcome, Rng

Array = NDArray[np.float64]

MAX_DELAY_S = 0.03
"""Oldest measurement that a command is sent for, the default of the controller's node [s]."""
TICK_S = 0.005
"""Between two measurements, as the simulator's node publishes them [s]."""
BEFORE_S = (0.5, 1.5)
"""How long a flight is undisturbed before the fault, from a range [s]."""
AFTER_S = 6.0
"""How long a flight goes on behind the fault [s]."""
HELIX = Helix(start_height_m=20.0)
"""What is flown: the paper's, but high enough up that to lose height is not to hit the ground."""
TRACKED_M = (0.35, 1.0)
"""How near the reference a vehicle is that has recovered, horizontally and vertically [m]: what
the mismatch costs it anyhow, without any fault."""


@dataclass(frozen=True)
class Measurement:
    """Odometry and rotor speeds of one instant, as the controller's node takes them."""

    stamp_ns: int
    """When they were measured [ns]."""
    x: Array
    """State, shape (12 + N_p,)."""


@dataclass(frozen=True)
class Command:
    """A plan on its way to the simulator."""

    stamp_ns: int
    """Of the measurement that it was made from [ns]."""
    u_plan: Array
    """Rotor accelerations [Hz/s], shape (N, N_p)."""


Sent = Iterable[tuple[float, Any]]
"""What a link makes of a message: how late each copy arrives [s], and the copy."""
Link = Callable[["DisturbedFlight", Any], Sent]
Action = Callable[["DisturbedFlight"], None]


def untouched(_: DisturbedFlight, message: Any) -> Sent:
    """Carry a message as it should be."""
    return [(0.0, message)]


def nothing(_: DisturbedFlight) -> None:
    """Do nothing."""


def world(rng: Rng) -> Scenario:
    """Draw a scenario in the paper's bounds."""
    return Scenario(helix=HELIX, seed=int(rng.integers(2**31))).sampled()


@dataclass(frozen=True)
class Disturbance:
    """A fault in the loop: what is other than it should be, from its beginning to its end."""

    lasts_s: tuple[float, float] = (1.0, 3.0)
    """How long, from a range [s]."""
    measured: Link = untouched
    """Carries measurements."""
    commanded: Link = untouched
    """Carries commands."""
    begin: Action = nothing
    """Done at its beginning."""
    end: Action = nothing
    """Done at its end."""
    scenario: Callable[[Rng], Scenario] = world
    """Chooses the world."""
    least_m: float = 0.0
    """The clearance that is promised [m]."""
    guarded: bool = False
    """Whether the guard is promised to be in charge when the flight is over."""
    recovers: bool = True
    """Whether the vehicle is promised to be back at its reference within `AFTER_S` of the end."""

    def __call__(self, rng: Rng) -> Outcome:
        """Try it once."""
        return DisturbedFlight(self, rng).outcome()


class Pilot:
    """What the controller's node does with what it hears, without ROS."""

    def __init__(self, controller: Any) -> None:
        self.controller = controller
        self.controller.reset()
        self._schedule = Schedule(round(controller.config.sampling_time_s * NANOSECONDS))
        self._order = StampOrder()
        self._begins_again = False
        self._plausibility = Plausibility(controller.config.vehicle)
        self._fitness = Fitness()
        self._last: Command | None = None
        self.dropped = 0
        """How many measurements it could not use."""

    def hear(self, now_s: float, measurement: Measurement) -> Command | None:
        """Take a measurement at a time [s], and give the command that it asks for."""
        stamp_ns, x = measurement.stamp_ns, measurement.x
        try:
            if not np.isfinite(x).all():
                raise MessageError("not finite")
            if self._order.admit(stamp_ns):
                self._begins_again = True
                self._plausibility.reset()
            self._plausibility.check(stamp_ns, x[: ROTORS.start])
        except MessageError:
            self.dropped += 1
            return None
        if now_s - stamp_ns / NANOSECONDS > MAX_DELAY_S + 1e-9:
            return None
        due, self._begins_again = self._schedule.admit(stamp_ns, self._begins_again), False
        if due is Due.NOTHING:
            return None
        if due is not Due.REPEAT:
            if due is Due.RESTART:
                self.controller.reset()
            solution = self.controller.step(self._schedule.time_ns / NANOSECONDS, x)
            unfit = self._fitness.reason(stamp_ns / NANOSECONDS, x, solution)
            self._last = None if unfit else Command(stamp_ns, solution.u_plan.copy())
        return self._last


class DisturbedFlight:
    """One flight under one disturbance."""

    def __init__(self, disturbance: Disturbance, rng: Rng) -> None:
        self.disturbance, self.rng = disturbance, rng
        self.scenario = disturbance.scenario(rng)
        sampling_time_s = controller().config.sampling_time_s
        self.simulation = Simulation(self.scenario, sampling_time_s)
        self.session = Session(self.simulation, sampling_time_s, TICK_S, False, 0.0)
        self.pilot: Pilot | None = Pilot(controller())
        self.starts_s = float(rng.uniform(*BEFORE_S))
        self.ends_s = self.starts_s + float(rng.uniform(*disturbance.lasts_s))
        self.disturbed = False
        self._kept: dict[str, Any] = {}
        self._order = itertools.count()
        self._on_way: list[tuple[float, int, Measurement | Command]] = []
        self._path: list[tuple[float, ...]] = []

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""
        return self.simulation.time_s

    def once(self, name: str, make: Callable[[], Any]) -> Any:
        """Give what was made under a name in this flight, or make it."""
        if name not in self._kept:
            self._kept[name] = make()
        return self._kept[name]

    def outcome(self) -> Outcome:
        """Fly it, and judge."""
        for k in range(round((self.ends_s + AFTER_S) / TICK_S)):
            inside = self.starts_s <= k * TICK_S < self.ends_s
            if inside is not self.disturbed:
                self.disturbed = inside
                (self.disturbance.begin if inside else self.disturbance.end)(self)
            self._exchange(k * TICK_S)
            if self.session.ready:
                self.session.advance()
            self._path.append((self.time_s, *self.simulation.x[POSITION].tolist()))
        return self._judged()

    def _exchange(self, now_s: float) -> None:
        """Publish the state, and deliver what is due, answers included."""
        self._send(now_s, Measurement(self.session.stamp_ns, self.simulation.x.copy()))
        while self._on_way and self._on_way[0][0] <= now_s + 1e-9:
            message = heapq.heappop(self._on_way)[2]
            if isinstance(message, Command):
                self.session.command(message.stamp_ns, message.u_plan)
            elif self.pilot is not None:
                command = self.pilot.hear(now_s, message)
                if command is not None:
                    self._send(now_s, command)

    def _send(self, now_s: float, message: Measurement | Command) -> None:
        faults = self.disturbance
        link = faults.commanded if isinstance(message, Command) else faults.measured
        for delay_s, each in (link if self.disturbed else untouched)(self, message):
            heapq.heappush(self._on_way, (now_s + delay_s, next(self._order), each))

    def _judged(self) -> Outcome:
        faults, path = self.disturbance, np.array(self._path)
        least_m = float(self.scenario.tower.clearance(path[:, 1:]).min())
        if not np.isfinite(path).all():
            return Outcome(False, None, None, "the state is not finite")
        recovery_s = self._recovery_s(path) if faults.recovers else None
        if path[:, 3].min() <= 0.0:
            return Outcome(False, least_m, recovery_s, "hit the ground")
        if least_m <= faults.least_m:
            return Outcome(False, least_m, recovery_s, f"came within {faults.least_m:g} m")
        if faults.guarded and not self.session.guard_active:
            return Outcome(False, least_m, None, "the guard is not in charge")
        if faults.recovers and recovery_s is None:
            return Outcome(False, least_m, None, f"not back within {AFTER_S:g} s")
        return Outcome(True, least_m, recovery_s)

    def _recovery_s(self, path: Array) -> float | None:
        """From the end of the fault until the vehicle is and stays near its reference [s]."""
        after = path[round(self.ends_s / TICK_S) :]
        reference = self.scenario.helix.at(after[:, 0], self.scenario.tower).position
        off = after[:, 1:] - reference
        away = np.flatnonzero(
            (np.hypot(off[:, 0], off[:, 1]) > TRACKED_M[0]) | (np.abs(off[:, 2]) > TRACKED_M[1])
        )
        if away.size == 0:
            return 0.0
        last = int(away[-1])
        return None if last == len(after) - 1 else (last + 1) * TICK_S


@lru_cache(maxsize=1)
def controller() -> Controller:
    """Make the controller, once a process: the paper's problem with our defaults, robust."""
    return Controller(ControllerConfig(helix=HELIX))
