# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The simulated world between two instants: the plant, its gusts and the plan it plays."""

from __future__ import annotations

from math import isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_guard import Guard, GuardConfig
from gtmr_sim.gust import make_gust
from gtmr_sim.plant import Plant
from gtmr_sim.registry import EFFECTS
from gtmr_sim.scenario import Scenario, whole_steps

Array = NDArray[np.float64]

WATCH_PERIOD_S = 0.025
"""Between two looks of the guard while a plan is in charge, at most [s]."""
GUARD_PERIOD_S = 0.005
"""Between two of its looks while it is in charge itself, at most [s]."""


class Simulation:
    """A flight in progress, whose plans have an input every plan step [s].

    Time is counted in whole plant steps, so that a flight is the same however it is cut up. The
    guard of the scenario stands between plan and rotors; one that never takes charge changes
    nothing. Raises ConfigError if a plan step is no whole number of plant steps.
    """

    def __init__(self, scenario: Scenario, plan_step_s: float) -> None:
        self.scenario = scenario
        self._plan_step = self._steps("sampling_time_s", plan_step_s)
        self._hold = self._steps("gust_hold_s", scenario.gust_hold_s)
        self._watch, self._act = (
            max(1, int(period_s / scenario.step_s + 1e-6))
            for period_s in (WATCH_PERIOD_S, GUARD_PERIOD_S)
        )
        self._guard = None
        if scenario.guard == "retreat":
            # A controller that plans seldom may miss two plans as well.
            usual = GuardConfig()
            config = GuardConfig(
                max_plan_age_s=max(usual.max_plan_age_s, 3.0 * plan_step_s),
                fresh_s=max(usual.fresh_s, 2.0 * plan_step_s),
            )
            self._guard = Guard(scenario.vehicle, scenario.tower, config)
        self.reset()

    def reset(self) -> None:
        """Go back to the start of the same flight."""
        scenario = self.scenario
        start = scenario.helix.initial_state(scenario.tower, scenario.vehicle)
        effects = tuple(EFFECTS[name] for name in scenario.effects)
        self.plant = Plant(
            scenario.vehicle, scenario.zeta_array, start, scenario.step_s, scenario.tower, effects
        )
        self._gust = make_gust(scenario)
        self._step = 0
        self._no_plan = self._plan = np.zeros((0, scenario.vehicle.n_rotors))
        self._plan_start = 0
        self._usable = True
        self._looked = 0
        self._guarded_steps = 0
        if self._guard is not None:
            self._guard.reset()
        self._draw_gust()

    def reconfigure(self, scenario: Scenario) -> None:
        """Go on in another scenario: with another zeta, other gusts, other bounds.

        The next gust sample is the first of the new gusts, which begin with the seed. What the
        flight began with, such as its vehicle, stays.
        """
        old, self.scenario = self.scenario, scenario
        self.plant.zeta = scenario.zeta_array
        if (scenario.gust, scenario.uncertainty) != (old.gust, old.uncertainty):
            self._gust = make_gust(scenario)
        if self._guard is not None and scenario.tower != old.tower:
            self._guard.reconfigure(scenario.tower)

    @property
    def time_s(self) -> float:
        """Simulated time since the start [s]."""
        return self._step * self.scenario.step_s

    @property
    def x(self) -> Array:
        """True state, shape (12 + N_p,)."""
        return self.plant.x

    @property
    def gust_n(self) -> Array:
        """Gust force that acts from now on, world frame [N], shape (3,)."""
        return self._w_g

    @property
    def plan_index(self) -> int:
        """Which input of the plan is due now.

        Past its end the rotors hold their speeds, until the guard takes charge.
        """
        return (self._step - self._plan_start) // self._plan_step

    @property
    def guard_active(self) -> bool:
        """Whether the guard is in charge."""
        return self._guard is not None and self._guard.active

    @property
    def guard_cause(self) -> str:
        """Why the guard is in charge, one of `gtmr_guard.CAUSES`; empty if it is not."""
        return self._guard.cause if self._guard is not None else ""

    @property
    def guard_time_s(self) -> float:
        """How long the guard has been in charge, since the start of the flight [s]."""
        return self._guarded_steps * self.scenario.step_s

    def command(self, stamp_s: float, u_plan: ArrayLike) -> None:
        """Take over a new plan, to be played from its stamp on.

        The stamp is the simulated time of the state that it was made for [s]; its rotor
        accelerations [Hz/s], shape (N, N_p), have one row every plan step. Where its shape is
        another, or it has what is no number, the guard takes charge.
        """
        plan = np.asarray(u_plan, dtype=float)
        if self._guard is not None:
            # The quickest way to see what is infinite or no number.
            finite = isfinite(np.vdot(plan, plan))
            self._usable = finite and plan.shape[1:] == self._no_plan.shape[1:]
        self._plan = plan if self._usable else self._no_plan
        self._plan_start = round(stamp_s / self.scenario.step_s)

    def advance(self, duration_s: float) -> None:
        """Fly on, playing the plan."""
        end = self._step + self._steps("duration_s", duration_s)
        while self._step < end:
            into_plan = (self._step - self._plan_start) % self._plan_step
            into_hold = self._step % self._hold
            n = min(end - self._step, self._plan_step - into_plan, self._hold - into_hold)
            u = self._input()
            if self._guard is not None:
                u, until = self._guarded(self._guard, u)
                n = min(n, until - self._step)
                self._guarded_steps += n * self._guard.active
            self.plant.advance(u, self._w_g, n)
            self._step += n
            if self._step % self._hold == 0:
                self._draw_gust()

    def _input(self) -> Array:
        index = self.plan_index
        if 0 <= index < len(self._plan):
            return self._plan[index]
        return np.zeros(self.scenario.vehicle.n_rotors)

    def _guarded(self, guard: Guard, u: Array) -> tuple[Array, int]:
        """Let the guard look if it is time; gives the input, and when it looks next."""
        period = self._act if guard.active else self._watch
        if self._step % period == 0:
            step_s, age = self.scenario.step_s, self._step - self._plan_start
            overdue_s = (age - len(self._plan) * self._plan_step) * step_s
            due = u if self._usable else np.full(len(u), np.nan)
            dt_s = (self._step - self._looked) * step_s
            self._looked = self._step
            self._guard_input = guard.step(dt_s, self.x, due, overdue_s, age * step_s)
            period = self._act if guard.active else self._watch
        until = (self._step // period + 1) * period
        return (self._guard_input if guard.active else u), until

    def _draw_gust(self) -> None:
        self._w_g = self._gust(self.time_s, self.plant.x[:3])

    def _steps(self, name: str, time_s: float) -> int:
        return whole_steps(name, time_s, "step_s", self.scenario.step_s)
