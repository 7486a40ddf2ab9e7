# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The flight between two instants in NumPy, the same as in C: its oracle, and the fallback."""

from __future__ import annotations

import numpy as np

from gtmr_guard import Guard
from gtmr_model.dynamics import ROTORS
from gtmr_sim.gust import Gust
from gtmr_sim.loop.parts import Array, Parts, Plan
from gtmr_sim.plant import Plant
from gtmr_sim.worlds.wind import WindField


class ReferenceLoop:
    """See `Loop`."""

    def __init__(self, parts: Parts) -> None:
        self._has = parts
        self.step = self.cause = self.guarded = 0
        self._seen = -1
        self._looked = parts.looked
        self._no_plan = Plan(0, np.zeros((0, parts.vehicle.n_rotors)), None, usable=True)
        self._plan = self._no_plan
        self._coming: list[tuple[int, Plan]] = []
        if parts.sensor is not None:
            parts.sensor.measure(0, parts.plant.x)
        self._draw()

    @property
    def plan_start(self) -> int:
        """See `Loop.plan_start`."""
        return self._plan.start

    def replace(
        self,
        plant: Plant | None = None,
        gust: Gust | None = None,
        wind: WindField | None = None,
    ) -> None:
        """See `Loop.replace`."""
        has = self._has
        has.plant, has.gust, has.wind = plant or has.plant, gust or has.gust, wind or has.wind

    def play(self, plan: Plan, acts: int) -> None:
        """See `Loop.play`."""
        self._coming = [each for each in self._coming if each[0] < acts]
        self._coming.append((acts, plan))
        self._take_over()

    def _take_over(self) -> None:
        """Play the plan whose time has come."""
        while self._coming and self._coming[0][0] <= self.step:
            self._plan = self._coming.pop(0)[1]

    def newest(self) -> tuple[int, Array] | None:
        """See `Loop.newest`."""
        sensor = self._has.sensor
        return (self.step, self._has.plant.x) if sensor is None else sensor.newest(self.step)

    def advance(self, end: int) -> None:
        """See `Loop.advance`."""
        has = self._has
        while self.step < end:
            into_plan = (self.step - self._plan.start) % has.plan_step
            n = min(end - self.step, has.plan_step - into_plan)
            n = min(n, has.hold - self.step % has.hold)
            if self._coming:
                n = min(n, self._coming[0][0] - self.step)
            if has.sensor is not None:
                n = min(n, has.sample - self.step % has.sample)
            u = self._input()
            # Before its first plan is due a vehicle waits, and needs no guard.
            if has.guard is not None and not (self._coming and self._plan is self._no_plan):
                u, until = self._guarded(has.guard, u)
                n = min(n, until - self.step)
                self.guarded += n if self.cause else 0
            if has.has_motors:
                u = self._tell_motors(u)
            has.plant.advance(u, self.gust_n, n)
            self.step += n
            self._take_over()
            if self.step % has.hold == 0:
                self._draw()
            if has.sensor is not None and self.step % has.sample == 0:
                has.sensor.measure(self.step, has.plant.x)

    def _input(self) -> Array:
        index = (self.step - self._plan.start) // self._has.plan_step
        if index < len(self._plan.u):
            return self._plan.u[index]
        return np.zeros(self._has.vehicle.n_rotors)

    def _tell_motors(self, u: Array) -> Array:
        """Set the motors' setpoints for now; gives their rate [Hz/s], shape (N_p,)."""
        has, told = self._has, self._plan.setpoints_hz
        if told is None or self.cause:
            # Not beyond what rotors can follow, or they would not turn back at once.
            low, high = has.vehicle.min_rotor_speed_hz, has.vehicle.max_rotor_speed_hz
            has.plant.setpoints_hz = np.clip(has.plant.setpoints_hz, low, high)
            return u
        steps, into = divmod(self.step - self._plan.start, has.plan_step)
        if steps >= len(told) - 1:
            has.plant.setpoints_hz = told[-1]
            return np.zeros_like(u)
        change = told[steps + 1] - told[steps]
        has.plant.setpoints_hz = told[steps] + into / has.plan_step * change
        return np.asarray(change / (has.plan_step * has.step_s))

    def _guarded(self, guard: Guard, u: Array) -> tuple[Array, int]:
        """Step the guard if it is time; returns the input, and when the next step is."""
        has = self._has
        period = has.act if self.cause else has.watch
        if self.step % period == 0:
            age = self.step - self._plan.start
            overdue_s = (age - len(self._plan.u) * has.plan_step) * has.step_s
            due = u if self._plan.usable else np.full(len(u), np.nan)
            dt_s = (self.step - self._looked) * has.step_s
            self._looked = self.step
            self._guard_u = guard.step(dt_s, self._sight(), due, overdue_s, age * has.step_s)
            self.cause = guard.cause_index
            period = has.act if self.cause else has.watch
        until = (self.step // period + 1) * period
        return (self._guard_u if self.cause else u), until

    def _sight(self) -> Array:
        """Give the guard the newest measured state, NaN if nothing new arrived."""
        newest, x = self.newest(), self._has.plant.x
        if newest is None or newest[0] <= self._seen:
            return np.full_like(x, np.nan)
        self._seen = newest[0]
        seen = newest[1].copy()
        # It sits at the actuators, whose speeds it reads at once.
        seen[ROTORS] = x[ROTORS]
        return seen

    def _draw(self) -> None:
        has, position = self._has, self._has.plant.x[:3]
        self.gust_n = has.gust(self.step * has.step_s, position)
        if has.wind is not None:
            has.plant.air_m_s = has.wind(position)
