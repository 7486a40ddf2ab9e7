# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The flight between two instants in C: the sources under ``c/``, and the memory of a flight."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np

from gtmr_codegen.library import CompileError
from gtmr_guard import Guard
from gtmr_sim.gust import Gust
from gtmr_sim.loop.memory import CAhead, CFlight, CLoop, CPlan, library
from gtmr_sim.loop.parts import Array, Parts, Plan
from gtmr_sim.plant import Plant
from gtmr_sim.worlds.sensor import Sensor
from gtmr_sim.worlds.wind import WindField

ROWS_AHEAD = 128
"""How many random numbers are drawn at a time, in samples."""
PLANS, PLAN_ROWS = 4, 20
"""Room for plans that a flight begins with; there is more where it takes more."""
NEEDS_GUST, NEEDS_TURBULENCE, NEEDS_NUMBERS, PLANT_ENDED, NEEDS_ROOM, REFUSED, NOT_FINITE = range(
    1, 8
)
"""By ``gtmr_loop_status`` and ``gtmr_flight.h``."""
NO_PLAN, UNUSABLE, USABLE = range(3)
"""By ``gtmr_loop_kind``."""
PlantStep = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int)
"""``gtmr_loop_plant``."""


class CompiledLoop:
    """See `Loop`; CompileError if it, or the guard, is not compiled.

    A plant that is not, and gusts that are not known ahead, are called back.
    """

    def __init__(self, parts: Parts) -> None:
        self._library = library()
        self._has = parts
        # The library has no memory of its own: all of this must live as long as the flight.
        self._kept: dict[str, object] = {}
        vehicle = parts.vehicle
        self._loop = CLoop(
            plan_step=parts.plan_step,
            hold=parts.hold,
            sample=parts.sample,
            watch=parts.watch,
            act=parts.act,
            step_s=parts.step_s,
            n_rotors=vehicle.n_rotors,
            has_motors=parts.has_motors,
            min_rotor_speed_hz=vehicle.min_rotor_speed_hz,
            max_rotor_speed_hz=vehicle.max_rotor_speed_hz,
            seen=-1,
            looked=parts.looked,
            newest_made=-1,
        )
        self._pointer = ctypes.pointer(self._loop)
        self._make_room(PLANS, PLAN_ROWS)
        if parts.guard is not None:
            self._set_guard(parts.guard)
        if parts.sensor is not None:
            self._set_sensor(parts.sensor)
            self._library.gtmr_loop_measure(self._pointer)
        self.replace(parts.plant, parts.gust, parts.wind)
        self._library.gtmr_loop_draw(self._pointer)
        self.advance(0)

    def _room(self, name: str, shape: tuple[int, ...], dtype: type = float) -> int:
        """Keep an array in the memory of this flight, and give its address."""
        array: Any = np.zeros(shape, dtype)
        self._kept[name] = array
        return int(array.ctypes.data)

    def _make_room(self, plans: int, rows: int) -> None:
        """Make room for plans of some rows, the one in play among them; keep those there are."""
        loop, n = self._loop, self._loop.n_rotors
        old = [loop.plans[i] for i in range(loop.coming + 1)] if loop.plans_room else []
        told = np.zeros((plans, 2, rows + 1, n))
        made = (CPlan * plans)()
        for i, plan in enumerate(made):
            u, setpoints = told[i].ctypes.data, told[i, 1].ctypes.data
            if i < len(old):
                fields = (old[i].acts, old[i].start, old[i].kind, old[i].n, old[i].has_setpoints)
                made[i] = CPlan(*fields, u, setpoints)
                ctypes.memmove(u, old[i].u, 8 * n * old[i].n)
                ctypes.memmove(setpoints, old[i].setpoints_hz, 8 * n * (old[i].n + 1))
            else:
                plan.u, plan.setpoints_hz = u, setpoints
        loop.plans = made
        loop.plans_room, loop.plan_rows_room = plans, rows
        self._kept |= {"plans": made, "rows of plans": told}

    def _set_guard(self, guard: Guard) -> None:
        if guard.addresses is None:
            raise CompileError("the guard is not compiled")
        loop, n = self._loop, self._loop.n_rotors
        loop.guard, loop.guard_memory = guard.addresses
        loop.guard_u, loop.guard_due = self._room("u", (n,)), self._room("u due", (n,))
        loop.guard_sight = self._room("sight", (12 + n,))

    def _set_sensor(self, sensor: Sensor) -> None:
        loop, odometry, n_x = self._loop, sensor.odometry, 12 + self._loop.n_rotors
        loop.has_sensor = True
        loop.noise_std[:] = sensor.std
        loop.bias_m[:] = sensor.bias_m
        loop.bias_kept, loop.bias_spread_m = sensor.bias_kept, sensor.bias_spread_m
        loop.rotor_quantum_hz = odometry.rotor_quantum_hz
        loop.delay_s, loop.jitter_s = odometry.delay_s, odometry.jitter_s
        loop.dropout = odometry.dropout
        # As many as are measured while the first of them is on its way, and one that is measured.
        room = math.ceil(odometry.delay_s / loop.step_s) // loop.sample + 3
        loop.way_room = room
        loop.way_arrives = self._room("arrive", (room,), np.int64)
        loop.way_made = self._room("made", (room,), np.int64)
        loop.way_x = self._room("on their way", (room, n_x))
        self._newest_x = np.zeros(n_x)
        loop.newest_x = self._newest_x.ctypes.data

    def replace(
        self,
        plant: Plant | None = None,
        gust: Gust | None = None,
        wind: WindField | None = None,
    ) -> None:
        """See `Loop.replace`."""
        has, loop = self._has, self._loop
        if plant is not None:
            has.plant = plant
            loop.x, loop.setpoints_hz, loop.u, loop.w_g, loop.air_m_s = plant.addresses
            loop.advance = plant.function or self._called_back(plant)
        if gust is not None:
            has.gust, loop.gust = gust, CAhead()
            loop.gust_is_inward = gust.inward
        if wind is not None:
            has.wind, loop.turbulence = wind, CAhead()
            loop.has_wind, loop.is_turbulent = True, wind.turbulence is not None
            loop.far_m_s[:], loop.along[:] = wind.far, wind.along
            loop.reference_height_m = wind.wind.reference_height_m
            loop.profile_exponent = wind.wind.profile_exponent
            loop.tower_radius_m = wind.tower.radius_m
            loop.tower_drag_coefficient = wind.wind.tower_drag_coefficient
            loop.flow_around_tower, loop.wake = wind.wind.flow_around_tower, wind.wind.wake

    def _called_back(self, plant: Plant) -> int | None:
        """Give the address of a function that advances a plant in Python."""

        def advance(_: int, steps: int) -> int:
            try:
                plant.advance(plant.u, plant.w_g, steps)
            except BaseException as error:  # passed on where the flight ends
                self._error = error
                return 1
            return 0

        function = PlantStep(advance)
        self._kept["plant"] = function
        return ctypes.cast(function, ctypes.c_void_p).value

    @property
    def step(self) -> int:
        """See `Loop.step`."""
        return int(self._loop.step)

    @property
    def plan_start(self) -> int:
        """See `Loop.plan_start`."""
        return int(self._loop.plans[0].start)

    @property
    def gust_n(self) -> Array:
        """See `Loop.gust_n`."""
        return np.array(self._loop.gust_n)

    @property
    def cause(self) -> int:
        """See `Loop.cause`."""
        return int(self._loop.cause)

    @property
    def guarded(self) -> int:
        """See `Loop.guarded`."""
        return int(self._loop.guarded)

    def play(self, plan: Plan, acts: int) -> None:
        """See `Loop.play`."""
        loop = self._loop
        u = np.ascontiguousarray(plan.u)
        told = None if plan.setpoints_hz is None else np.ascontiguousarray(plan.setpoints_hz)
        kind = USABLE if plan.usable else UNUSABLE
        addresses = (u.ctypes.data, None if told is None else told.ctypes.data)
        given = (plan.start, acts, kind, len(u), *addresses)
        if not self._library.gtmr_loop_play(self._pointer, *given):
            self._make_room(2 * loop.plans_room, max(len(u), loop.plan_rows_room))
            self._library.gtmr_loop_play(self._pointer, *given)

    def newest(self) -> tuple[int, Array] | None:
        """See `Loop.newest`."""
        if self._has.sensor is None:
            return self.step, self._has.plant.x
        made = self._library.gtmr_loop_newest(self._pointer)
        return None if made < 0 else (made, self._newest_x.copy())

    def advance(self, end: int) -> None:
        """See `Loop.advance`."""
        while status := self._library.gtmr_loop_advance(self._pointer, end):
            self._supply(status)

    def run(self, flight: CFlight, until: int) -> int:
        """Fly a closed loop in C on until a step; gives how it ended.

        Zero, or that the controller refused a state, or a plan of it was not finite.
        """
        flight.loop = self._pointer
        while status := self._library.gtmr_flight_run(ctypes.byref(flight), until):
            if status in (REFUSED, NOT_FINITE):
                return int(status)
            if status == NEEDS_ROOM:
                rows = max(flight.stages, self._loop.plan_rows_room)
                self._make_room(2 * self._loop.plans_room, rows)
            else:
                self._supply(status)
        return 0

    def _supply(self, status: int) -> None:
        """Draw what the compiled loop needs to go on; raises what a plant in Python has raised."""
        has, loop = self._has, self._loop
        if status == PLANT_ENDED:
            raise self._error
        if status == NEEDS_GUST:
            time_s, position = self.step * loop.step_s, has.plant.x[:3]
            rows: Array = has.gust.rows(ROWS_AHEAD, time_s, position)
            loop.gust = self._drawn("gust", rows)
        elif status == NEEDS_TURBULENCE:
            assert has.wind is not None
            assert has.wind.turbulence is not None
            loop.turbulence = self._drawn("turbulence", has.wind.turbulence.draw(ROWS_AHEAD))
        else:
            assert has.sensor is not None
            loop.numbers = self._drawn("numbers", has.sensor.draw(ROWS_AHEAD))

    def _drawn(self, name: str, rows: Array) -> CAhead:
        rows = np.ascontiguousarray(rows)
        self._kept[name] = rows
        return CAhead(rows.ctypes.data, len(rows), 0)
