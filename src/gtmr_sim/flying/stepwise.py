# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A closed loop step by step, for a controller of any kind."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gtmr_sim.flying.step import BY_STAGE, Rows, Step
from gtmr_sim.simulation import Simulation

Array = NDArray[np.float64]


class FlightError(ValueError):
    """A controller gave what cannot be flown; the message is one line naming it and the time."""


class StepController(Protocol):
    """Anything that flies the vehicle."""

    def step(self, t: float, x: Array) -> Any:
        """Decide from state x, shape (12 + N_p,), at time t [s].

        Either rotor accelerations to hold until the next step [Hz/s], shape (N_p,), or an object
        whose ``u_plan``, shape (n, N_p), is played one row a sampling time. Such an object may
        also have ``setpoints_hz``, shape (n + 1, N_p), which motors follow where the world has
        some, and ``alpha_p``, ``alpha_g``, ``slack``, ``status`` and ``timing.total_s`` as a
        `gtmr_nmpc.Solution` has them; what it has goes into the flight's log.

        A controller whose step is compiled may also have ``native()``, which returns a
        `gtmr_sim.flying.native.NativeStep`, or None: then the whole flight is one call in C.

        In a world whose odometry is late, t is the stamp of what was measured, and a ``step`` that
        takes ``now`` is also told the time from which its plan is played [s]; accelerations alone,
        from one that does not, are held from the moment at which it is asked.

        For oracles alone, which show what no controller can do better: one that has a method
        ``see_truth(simulation)`` is handed the `Simulation` before its first step, to look at.
        """
        ...


def read_step(
    controller: StepController, t: float, result: Any, n_rotors: int, elapsed_s: float
) -> Step:
    """Read what a controller returned at time t [s]; FlightError if it cannot be flown."""
    try:
        return Step.of(result, n_rotors, elapsed_s)
    except (TypeError, ValueError) as error:
        raise FlightError(f"{type(controller).__name__}.step at t = {t:g} s: {error}") from None


def fly_stepwise(
    simulation: Simulation,
    controller: StepController,
    tells_now: bool,
    sampling_time_s: float,
    steps: int,
    on_step: Callable[[int], None] | None,
) -> Rows:
    """Fly some steps; ``tells_now`` is whether the controller is told when its plan acts."""
    scenario = simulation.scenario
    states, gusts, winds, guarded = [], [], [], []
    measured: list[Array] = []
    taken: list[Step] = []
    for k in range(steps):
        t = simulation.time_s
        states.append(simulation.x)
        # Only at the start there is always one; late measurements may leave a gap after it.
        newest = simulation.measured()
        if newest is None:
            measured.append(measured[-1])
            taken.append(taken[-1])
        else:
            stamp_s, x = newest
            measured.append(x.copy())
            now_s = stamp_s + scenario.world.odometry.delay_s if tells_now else stamp_s
            start = time.perf_counter()
            # The copy of a measurement: what a controller does to it must not reach the plant.
            result = (
                controller.step(stamp_s, x, now=now_s)  # type: ignore[call-arg]
                if tells_now
                else controller.step(stamp_s, x)
            )
            elapsed_s = time.perf_counter() - start
            step = read_step(controller, t, result, scenario.vehicle.n_rotors, elapsed_s)
            if taken and step.told != taken[0].told:
                raise FlightError(
                    f"{type(controller).__name__}.step at t = {t:g} s: told {step.told}, in its "
                    f"first step {taken[0].told}"
                )
            taken.append(step)
            # From the stamp of a late state on, a single row would be over before it arrives.
            held = len(step.u_plan) == 1 and not tells_now
            acts_s = simulation.time_s if held else now_s
            simulation.command(acts_s, step.u_plan, step.setpoints_hz)
        gusts.append(simulation.gust_n)
        winds.append(simulation.wind_n)
        simulation.advance(sampling_time_s)
        guarded.append(simulation.guard_active)
        if on_step is not None:
            on_step(k + 1)
    told = [step.failed for step in taken if step.failed is not None]
    return Rows(
        x=np.array(states),
        x_measured=np.array(measured),
        u=np.array([step.u_plan[0] for step in taken]),
        w_g=np.array(gusts),
        wind_n=np.array(winds),
        **{name: np.array([getattr(step, name) for step in taken]) for name in BY_STAGE},
        solve_ms=np.array([step.solve_ms for step in taken]),
        failed=np.array(told, dtype=bool),
        guard=np.array(guarded, dtype=bool),
    )
