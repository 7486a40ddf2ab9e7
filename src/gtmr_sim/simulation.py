# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A flight between two instants: the plant, its world and gusts, and the plan it plays."""

from __future__ import annotations

from math import isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_codegen.library import CompileError, warn_interpreted
from gtmr_guard import CAUSES, Guard, GuardConfig
from gtmr_model.dynamics import POSITION, YAW
from gtmr_sim.gust import make_gust
from gtmr_sim.loop.compiled import CompiledLoop
from gtmr_sim.loop.parts import Loop, Parts, Plan
from gtmr_sim.loop.reference import ReferenceLoop
from gtmr_sim.plant import Plant
from gtmr_sim.registry import EFFECTS
from gtmr_sim.scenario import Scenario, whole_steps
from gtmr_sim.worlds.sensor import Sensor
from gtmr_sim.worlds.wind import WindField, hover_drag, hover_force

Array = NDArray[np.float64]

WATCH_PERIOD_S = 0.025
"""Longest time between two checks of the guard while a plan is in charge [s]."""
GUARD_PERIOD_S = 0.005
"""Longest time between two of its steps while it is in charge itself [s]."""
WARM_UP_S = 1.0
"""How long the guard observes a vehicle before its flight, if odometry has noise [s]."""


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
            config = GuardConfig.told(plan_step_s, odometry.delay_s, scenario.world.lag_s)
            self._guard = Guard(scenario.vehicle, scenario.tower, config)
        self.reset()

    def reset(self) -> None:
        """Go back to the start of the same flight."""
        scenario = self.scenario
        odometry = scenario.world.odometry
        start = scenario.helix.initial_state(scenario.tower, scenario.vehicle)
        start[POSITION] += scenario.start_offset_m
        effects = tuple(EFFECTS[name] for name in scenario.effects)
        self._plant = Plant(
            scenario.vehicle,
            scenario.zeta_array,
            start,
            scenario.step_s,
            scenario.tower,
            effects,
            scenario.world,
        )
        sensor, looked = None, 0
        if not odometry.is_truth:
            sensor = Sensor(odometry, scenario.rng("odometry"), scenario.step_s, self._sample)
        if self._guard is not None:
            self._guard.reset()
            if sensor is not None:
                self._warm_up(self._guard)
                looked = -self._act
        self._handed_out = -1
        parts = Parts(
            vehicle=scenario.vehicle,
            step_s=scenario.step_s,
            plan_step=self._plan_step,
            hold=self._hold,
            sample=self._sample,
            watch=self._watch,
            act=self._act,
            has_motors=scenario.world.motors is not None,
            plant=self._plant,
            gust=make_gust(scenario),
            wind=self._wind(),
            sensor=sensor,
            guard=self._guard,
            looked=looked,
        )
        self._loop: Loop
        try:
            self._loop = CompiledLoop(parts)
        except CompileError as error:
            warn_interpreted(error)
            self._loop = ReferenceLoop(parts)

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

    def _wind(self) -> WindField | None:
        """Start the wind of the scenario, if its world has one."""
        scenario = self.scenario
        if scenario.world.wind is None:
            return None
        wind, zeta = scenario.world.wind, scenario.zeta_array
        self._hover_drag = hover_drag(wind, zeta, scenario.vehicle)
        rng, height_m = scenario.rng("wind"), float(self.x[2])
        return WindField(
            wind, zeta, scenario.vehicle, scenario.tower, rng, scenario.gust_hold_s, height_m
        )

    def reconfigure(self, scenario: Scenario) -> None:
        """Continue in another scenario: with another zeta, other gusts, other bounds.

        The next gust sample is the first of the new gusts, which begin with the seed. What the
        flight began with, such as its vehicle, stays.
        """
        old, self.scenario = self.scenario, scenario
        self.plant.zeta = scenario.zeta_array
        if (scenario.gust, scenario.uncertainty) != (old.gust, old.uncertainty):
            self._loop.replace(gust=make_gust(scenario))
        if scenario.zeta != old.zeta:
            self._loop.replace(wind=self._wind())
        if self._guard is not None and scenario.tower != old.tower:
            self._guard.reconfigure(scenario.tower)

    @property
    def plant(self) -> Plant:
        """The true vehicle; another one may take its place in flight."""
        return self._plant

    @plant.setter
    def plant(self, plant: Plant) -> None:
        self._plant = plant
        self._loop.replace(plant=plant)

    @property
    def time_s(self) -> float:
        """Simulated time since the start [s]."""
        return self._loop.step * self.scenario.step_s

    @property
    def x(self) -> Array:
        """True state, shape (12 + N_p,)."""
        return self.plant.x

    @property
    def gust_n(self) -> Array:
        """Gust force that acts from now on, world frame [N], shape (3,)."""
        return self._loop.gust_n

    @property
    def wind_n(self) -> Array:
        """Force of the wind from now on, on the vehicle at hover, world frame [N], shape (3,).

        In a world without a wind field it is w_b of eq. (3).
        """
        return self.wind_of(self.plant.air_m_s)

    def wind_of(self, air_m_s: Array) -> Array:
        """Say the same of velocities of the air, world frame [m/s], shape (..., 3)."""
        if self.scenario.world.wind is None:
            return self.scenario.zeta_array[6:9]
        return hover_force(self._hover_drag, air_m_s)

    @property
    def compiled(self) -> CompiledLoop | None:
        """What flies it in C, where there is a compiler."""
        return self._loop if isinstance(self._loop, CompiledLoop) else None

    @property
    def least_clearance_m(self) -> float:
        """Least d_T of any plant step so far [m]."""
        return self.plant.least_clearance_m

    def measured(self) -> tuple[float, Array] | None:
        """Hand out the newest measurement that has arrived, once: its stamp [s], and the state.

        The state has shape (12 + N_p,), with angles between -pi and pi where it is measured. None
        if nothing new has arrived.
        """
        newest = self._loop.newest()
        if newest is None or newest[0] <= self._handed_out:
            return None
        self._handed_out = newest[0]
        return newest[0] * self.scenario.step_s, newest[1].copy()

    @property
    def plan_index(self) -> int:
        """Which input of the plan is due now.

        Past its end the rotors hold their speeds, until the guard takes charge.
        """
        return (self._loop.step - self._loop.plan_start) // self._plan_step

    @property
    def guard_active(self) -> bool:
        """Whether the guard is in charge."""
        return self._loop.cause != 0

    @property
    def guard_cause(self) -> str:
        """Why the guard is in charge, one of `gtmr_guard.CAUSES`; empty if it is not."""
        return CAUSES[self._loop.cause]

    @property
    def guard_time_s(self) -> float:
        """How long the guard has been in charge, since the start of the flight [s]."""
        return self._loop.guarded * self.scenario.step_s

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
        told, motors, n_rotors = None, self.scenario.world.motors, self.scenario.vehicle.n_rotors
        fits = plan.ndim == 2 and plan.shape[1] == n_rotors
        # The quickest way to see what is infinite or no number.
        finite = isfinite(np.vdot(plan, plan))
        if motors is not None and setpoints_hz is not None:
            told = np.asarray(setpoints_hz, dtype=float)
            fits = fits and told.shape == (len(plan) + 1, n_rotors)
            finite = finite and isfinite(np.vdot(told, told))
        if not fits and self._guard is None:
            raise ValueError(f"u_plan has shape {plan.shape}, expected (N, {n_rotors})")
        usable = self._guard is None or (fits and finite)
        if not usable:
            plan, told = np.zeros((0, n_rotors)), None
        transport_s = 0.0 if motors is None else motors.transport_s
        start = round((stamp_s + transport_s) / self.scenario.step_s)
        acts = max(start, self._loop.step + round(transport_s / self.scenario.step_s))
        self._loop.play(Plan(start, plan, told, usable), acts)

    def advance(self, duration_s: float) -> None:
        """Fly, playing the plan."""
        self._loop.advance(self._loop.step + self._steps("duration_s", duration_s))

    def _steps(self, name: str, time_s: float) -> int:
        return whole_steps(name, time_s, "step_s", self.scenario.step_s)
