# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A flight between two instants: the plant, its world and gusts, and the plan it plays."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_guard import Guard, GuardConfig
from gtmr_model.dynamics import POSITION, ROTORS, YAW
from gtmr_sim.gust import make_gust
from gtmr_sim.plant import Plant
from gtmr_sim.registry import EFFECTS
from gtmr_sim.scenario import Scenario, whole_steps
from gtmr_sim.worlds.sensor import Sensor
from gtmr_sim.worlds.wind import hover_drag, make_wind

Array = NDArray[np.float64]

WATCH_PERIOD_S = 0.025
"""Longest time between two checks of the guard while a plan is in charge [s]."""
GUARD_PERIOD_S = 0.005
"""Longest time between two of its steps while it is in charge itself [s]."""
WARM_UP_S = 1.0
"""How long the guard observes a vehicle before its flight, if odometry has noise [s]."""
MAX_GUARD_DELAY_S = 0.2
"""Delay beyond which the guard slows no further [s]."""


@dataclass(frozen=True)
class _Plan:
    """Commands for the rotors from a plant step on, one row for each plan step."""

    start: int
    """When the plan begins, in plant steps."""
    u: Array
    """Rotor accelerations [Hz/s], shape (N, N_p)."""
    setpoints_hz: Array | None
    """Rotor speeds at the plan steps [Hz], shape (N + 1, N_p); none if the plan has none."""
    usable: bool
    """Whether it can be sent to the rotors."""


class Simulation:
    """A flight in progress, whose plans have an input every plan step [s].

    Time is counted in whole plant steps, so that a flight is the same however it is cut up. The
    guard of the scenario stands between plan and rotors; one that never takes charge changes
    nothing. It sees what is measured. Raises ConfigError if a plan step, or the time between two
    measurements, is no whole number of plant steps.
    """

    def __init__(self, scenario: Scenario, plan_step_s: float) -> None:
        self.scenario = scenario
        self._plan_step = self._steps("sampling_time_s", plan_step_s)
        self._hold = self._steps("gust_hold_s", scenario.gust_hold_s)
        self._watch, self._act = (
            max(1, int(period_s / scenario.step_s + 1e-6))
            for period_s in (WATCH_PERIOD_S, GUARD_PERIOD_S)
        )
        odometry = scenario.world.odometry
        self._sample = self._plan_step
        if odometry.rate_hz is not None:
            self._sample = self._steps("the period of rate_hz", 1.0 / odometry.rate_hz)
        self._guard = None
        if scenario.guard == "retreat":
            # A controller that plans seldom may miss two plans as well, and late measurements make
            # plans late.
            usual, late_s = GuardConfig(), odometry.delay_s
            config = GuardConfig(
                patience_s=usual.patience_s + late_s,
                max_plan_age_s=max(usual.max_plan_age_s, 3.0 * plan_step_s) + late_s,
                fresh_s=max(usual.fresh_s, 2.0 * plan_step_s) + late_s,
                delay_s=min(late_s + scenario.world.lag_s, MAX_GUARD_DELAY_S),
            )
            self._guard = Guard(scenario.vehicle, scenario.tower, config)
        self.reset()

    def reset(self) -> None:
        """Go back to the start of the same flight."""
        scenario = self.scenario
        start = scenario.helix.initial_state(scenario.tower, scenario.vehicle)
        start[POSITION] += scenario.start_offset_m
        effects = tuple(EFFECTS[name] for name in scenario.effects)
        self.plant = Plant(
            scenario.vehicle,
            scenario.zeta_array,
            start,
            scenario.step_s,
            scenario.tower,
            effects,
            scenario.world,
        )
        self._gust = make_gust(scenario)
        self._blow()
        self._sensor = None
        if not scenario.world.odometry.is_truth:
            odometry, rng = scenario.world.odometry, scenario.rng("odometry")
            self._sensor = Sensor(odometry, rng, scenario.step_s, self._sample)
            self._sensor.measure(0, self.x)
        self._handed_out = self._seen = -1
        self._step = 0
        self._no_plan = np.zeros((0, scenario.vehicle.n_rotors))
        self._plan = _Plan(0, self._no_plan, None, True)
        self._coming: list[tuple[int, _Plan]] = []
        self._looked = 0
        self._guarded_steps = 0
        if self._guard is not None:
            self._guard.reset()
            if self._sensor is not None:
                self._warm_up(self._guard)
        self._draw_gust()

    def _warm_up(self, guard: Guard) -> None:
        """Let the guard observe a vehicle before the start, until noise is no speed to it."""
        helix, tower, x = self.scenario.helix, self.scenario.tower, self.x.copy()
        step_s = self.scenario.step_s
        # With random numbers of its own, so that the guard does not change those of the flight.
        sensor = Sensor(
            self.scenario.world.odometry, self.scenario.rng("guard"), step_s, self._act
        )
        period_s = self._act * step_s
        before = helix.at(-period_s * np.arange(round(WARM_UP_S / period_s), 0, -1), tower)
        unmoved = np.zeros(self.scenario.vehicle.n_rotors)
        for x[POSITION], x[YAW] in zip(before.position, before.yaw, strict=True):
            guard.step(period_s, sensor.reading(x), unmoved, -period_s, 0.0)
        self._looked = -self._act

    def _blow(self) -> None:
        """Start the wind of the scenario, if its world has one."""
        scenario = self.scenario
        self._wind = None
        if scenario.world.wind is not None:
            wind, zeta = scenario.world.wind, scenario.zeta_array
            self._hover_drag = hover_drag(wind, zeta, scenario.vehicle)
            self._wind = make_wind(
                scenario.world.wind,
                scenario.zeta_array,
                scenario.vehicle,
                scenario.tower,
                scenario.rng("wind"),
                scenario.gust_hold_s,
                float(self.plant.x[2]),
            )

    def reconfigure(self, scenario: Scenario) -> None:
        """Continue in another scenario: with another zeta, other gusts, other bounds.

        The next gust sample is the first of the new gusts, which begin with the seed. What the
        flight began with, such as its vehicle, stays.
        """
        old, self.scenario = self.scenario, scenario
        self.plant.zeta = scenario.zeta_array
        if (scenario.gust, scenario.uncertainty) != (old.gust, old.uncertainty):
            self._gust = make_gust(scenario)
        if scenario.zeta != old.zeta:
            self._blow()
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
    def wind_n(self) -> Array:
        """Force of the wind from now on, on the vehicle at hover, world frame [N], shape (3,).

        In a world without a wind field it is w_b of eq. (3).
        """
        if self._wind is None:
            return self.scenario.zeta_array[6:9]
        return np.asarray(self._hover_drag @ self.plant.air_m_s)

    @property
    def least_clearance_m(self) -> float:
        """Least d_T of any plant step so far [m]."""
        return self.plant.least_clearance_m

    def measured(self) -> tuple[float, Array] | None:
        """Hand out the newest measurement that has arrived, once: its stamp [s], and the state.

        The state has shape (12 + N_p,), with angles between -pi and pi where it is measured. None
        if nothing new has arrived.
        """
        newest = self._newest()
        if newest is None or newest[0] <= self._handed_out:
            return None
        self._handed_out = newest[0]
        return newest[0] * self.scenario.step_s, newest[1].copy()

    def _newest(self) -> tuple[int, Array] | None:
        return (self._step, self.x) if self._sensor is None else self._sensor.newest(self._step)

    @property
    def plan_index(self) -> int:
        """Which input of the plan is due now.

        Past its end the rotors hold their speeds, until the guard takes charge.
        """
        return (self._step - self._plan.start) // self._plan_step

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

    def command(
        self, stamp_s: float, u_plan: ArrayLike, setpoints_hz: ArrayLike | None = None
    ) -> None:
        """Take over a new plan, to be played from its stamp on.

        Parameters
        ----------
        stamp_s : float
            Simulated time from which it acts [s]. If that has passed, it is played from where it
            should be by now; if it is still to come, the plan in play goes on until then.
        u_plan : array_like, shape (N, N_p)
            Rotor accelerations [Hz/s], a row every plan step. Where the shape is another, or it
            has what is no number, the guard takes charge.
        setpoints_hz : array_like, shape (N + 1, N_p), optional
            Rotor speeds at the plan steps [Hz], linear in between, for a world with motors; left
            out: integrated from ``u_plan``, from the last setpoint on.
        """
        plan = np.asarray(u_plan, dtype=float)
        world, usable = self.scenario.world, True
        told = None
        if world.motors is not None and setpoints_hz is not None:
            told = np.asarray(setpoints_hz, dtype=float)
        if self._guard is not None:
            # The quickest way to see what is infinite or no number.
            usable = isfinite(np.vdot(plan, plan)) and plan.shape[1:] == self._no_plan.shape[1:]
            if told is not None:
                usable = usable and isfinite(np.vdot(told, told))
                usable = usable and told.shape == (len(plan) + 1, *plan.shape[1:])
        transport_s = 0.0 if world.motors is None else world.motors.transport_s
        start = round((stamp_s + transport_s) / self.scenario.step_s)
        if not usable:
            plan, told = self._no_plan, None
        new = _Plan(start, plan, told, usable)
        acts = max(start, self._step + round(transport_s / self.scenario.step_s))
        self._coming = [each for each in self._coming if each[0] < acts]
        self._coming.append((acts, new))
        self._take_over()

    def _take_over(self) -> None:
        """Play the plan whose time has come."""
        while self._coming and self._coming[0][0] <= self._step:
            self._plan = self._coming.pop(0)[1]

    def advance(self, duration_s: float) -> None:
        """Fly, playing the plan."""
        end = self._step + self._steps("duration_s", duration_s)
        while self._step < end:
            into_plan = (self._step - self._plan.start) % self._plan_step
            into_hold = self._step % self._hold
            n = min(end - self._step, self._plan_step - into_plan, self._hold - into_hold)
            if self._coming:
                n = min(n, self._coming[0][0] - self._step)
            if self._sensor is not None:
                n = min(n, self._sample - self._step % self._sample)
            u = self._input()
            if self._guard is not None and not self._awaits_first_plan:
                u, until = self._guarded(self._guard, u)
                n = min(n, until - self._step)
                self._guarded_steps += n * self._guard.active
            if self.scenario.world.motors is not None:
                u = self._tell_motors(u)
            self.plant.advance(u, self._w_g, n)
            self._step += n
            if self._coming:
                self._take_over()
            if self._step % self._hold == 0:
                self._draw_gust()
            if self._sensor is not None and self._step % self._sample == 0:
                self._sensor.measure(self._step, self.plant.x)

    @property
    def _awaits_first_plan(self) -> bool:
        """Whether the first plan has come and is not due yet: rotors hold their speeds."""
        return bool(self._coming) and self._plan.u is self._no_plan and self._plan.usable

    def _input(self) -> Array:
        index = self.plan_index
        if 0 <= index < len(self._plan.u):
            return self._plan.u[index]
        return np.zeros(self.scenario.vehicle.n_rotors)

    def _tell_motors(self, u: Array) -> Array:
        """Set the motors' setpoints for now; gives their rate [Hz/s], shape (N_p,)."""
        vehicle, told = self.scenario.vehicle, self._plan.setpoints_hz
        if told is None or self.guard_active:
            # Not beyond what rotors can follow, or they would not turn back at once.
            low, high = vehicle.min_rotor_speed_hz, vehicle.max_rotor_speed_hz
            self.plant.setpoints_hz = np.clip(self.plant.setpoints_hz, low, high)
            return u
        steps, into = divmod(self._step - self._plan.start, self._plan_step)
        if steps >= len(told) - 1:
            self.plant.setpoints_hz = told[-1].copy()
            return np.zeros_like(u)
        change = told[steps + 1] - told[steps]
        self.plant.setpoints_hz = told[steps] + into / self._plan_step * change
        return change / (self._plan_step * self.scenario.step_s)

    def _guarded(self, guard: Guard, u: Array) -> tuple[Array, int]:
        """Step the guard if it is time; returns the input, and when the next step is."""
        period = self._act if guard.active else self._watch
        if self._step % period == 0:
            step_s, age = self.scenario.step_s, self._step - self._plan.start
            overdue_s = (age - len(self._plan.u) * self._plan_step) * step_s
            due = u if self._plan.usable else np.full(len(u), np.nan)
            dt_s = (self._step - self._looked) * step_s
            self._looked = self._step
            self._guard_input = guard.step(dt_s, self._sight(), due, overdue_s, age * step_s)
            period = self._act if guard.active else self._watch
        until = (self._step // period + 1) * period
        return (self._guard_input if guard.active else u), until

    def _sight(self) -> Array:
        """Give the guard the newest measured state, NaN if nothing new arrived."""
        newest = self._newest()
        if newest is None or newest[0] <= self._seen:
            return np.full_like(self.x, np.nan)
        self._seen = newest[0]
        seen = newest[1].copy()
        # It sits at the actuators, whose speeds it reads at once.
        seen[ROTORS] = self.x[ROTORS]
        return seen

    def _draw_gust(self) -> None:
        self._w_g = self._gust(self.time_s, self.plant.x[:3])
        if self._wind is not None:
            self.plant.air_m_s = self._wind(self.plant.x[:3])

    def _steps(self, name: str, time_s: float) -> int:
        return whole_steps(name, time_s, "step_s", self.scenario.step_s)
