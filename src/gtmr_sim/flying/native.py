# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A closed loop in one call, for a controller that offers its step to callers in C."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gtmr_sim.flying.step import BY_STAGE, Rows
from gtmr_sim.flying.stepwise import FlightError, StepController, read_step
from gtmr_sim.loop.compiled import NOT_FINITE
from gtmr_sim.loop.memory import CFlight
from gtmr_sim.simulation import Simulation

Array = NDArray[np.float64]

STEPS_A_CALL = 40
"""How often a progress bar is told, in steps."""


class NativeStep(Protocol):
    """A controller's step for callers in C: what its ``native()`` returns."""

    @property
    def function(self) -> int:
        """Address of ``int step(void *, double t, const double *x, double now, double *plan)``.

        It plans from the state x of the stamp t what acts from now on [s], and returns a status.
        """
        ...

    @property
    def memory(self) -> int:
        """Address of its first argument."""
        ...

    @property
    def plan_length(self) -> int:
        """Entries of ``plan``."""
        ...

    @property
    def parts(self) -> Mapping[str, tuple[int, tuple[int, ...]]]:
        """Where in ``plan`` what it tells begins, in entries, and its shape.

        ``u_plan``, ``setpoints_hz``, ``alpha_p``, ``alpha_g`` and ``slack``, as in what ``step``
        returns.
        """
        ...

    @property
    def statuses(self) -> Sequence[str]:
        """By what it returns; negative if it refuses its arguments."""
        ...


def native_step(controller: StepController) -> NativeStep | None:
    """Ask a controller for its step in C; None if it has none, or it would pass over ``step``.

    That is so where a class of yours has a ``step`` of its own, but ``native`` from its base.
    """
    kinds = type(controller).__mro__

    def defined(name: str) -> int | None:
        return next((i for i, kind in enumerate(kinds) if name in vars(kind)), None)

    offered, own = defined("native"), defined("step")
    if offered is None or own is None or own < offered or "step" in vars(controller):
        return None
    found: NativeStep | None = controller.native()  # type: ignore[attr-defined]
    return found


def fly_natively(
    simulation: Simulation,
    controller: StepController,
    native: NativeStep,
    tells_now: bool,
    sampling_time_s: float,
    steps: int,
    on_step: Callable[[int], None] | None,
) -> Rows:
    """Fly some steps as `fly_stepwise` does, to the last digit but for solve times."""
    loop, scenario = simulation.compiled, simulation.scenario
    assert loop is not None
    world, n = scenario.world, scenario.vehicle.n_rotors
    stages = native.parts["u_plan"][1][0]
    plan, x = np.zeros(native.plan_length), np.zeros(12 + n)
    logged: dict[str, Any] = {
        "x": np.zeros((steps, 12 + n)),
        "measured": np.zeros((steps, 12 + n)),
        "u": np.zeros((steps, n)),
        "gust_n": np.zeros((steps, 3)),
        "air_m_s": np.zeros((steps, 3)),
        **{name: np.zeros((steps, stages + 1)) for name in BY_STAGE},
        "solve_ms": np.zeros(steps),
        "failed": np.zeros(steps, bool),
        "guard": np.zeros(steps, bool),
    }
    places = {"u": "u_plan", "setpoints_hz": "setpoints_hz"} | {name: name for name in BY_STAGE}
    flight = CFlight(
        controller=native.function,
        controller_memory=native.memory,
        delay_s=world.odometry.delay_s,
        transport_s=0.0 if world.motors is None else world.motors.transport_s,
        tells_now=tells_now,
        failed=native.statuses.index("failed"),
        stages=stages,
        plan=plan.ctypes.data,
        handed_out=-1,
        x=x.ctypes.data,
        **{to: plan.ctypes.data + 8 * native.parts[name][0] for to, name in places.items()},
        **{f"log_{name}": array.ctypes.data for name, array in logged.items()},
    )
    calls = range(STEPS_A_CALL, steps, STEPS_A_CALL) if on_step is not None else ()
    for until in (*calls, steps):
        status = loop.run(flight, until)
        if status:
            _refuse(controller, native, flight, x, plan, status)
        if on_step is not None:
            on_step(until)
    return Rows(
        x=logged["x"],
        x_measured=logged["measured"],
        u=logged["u"],
        w_g=logged["gust_n"],
        wind_n=np.array(np.broadcast_to(simulation.wind_of(logged["air_m_s"]), (steps, 3))),
        **{name: logged[name] for name in BY_STAGE},
        solve_ms=logged["solve_ms"],
        failed=logged["failed"],
        guard=logged["guard"],
    )


def _refuse(
    controller: StepController,
    native: NativeStep,
    flight: CFlight,
    x: Array,
    plan: Array,
    status: int,
) -> None:
    """Raise what the same step would have raised from Python."""
    t, n_rotors = flight.loop.contents.step * flight.loop.contents.step_s, len(x) - 12
    if status == NOT_FINITE:
        parts = {
            name: plan[start : start + int(np.prod(shape))].reshape(shape)
            for name, (start, shape) in native.parts.items()
        }
        read_step(controller, t, SimpleNamespace(**parts), n_rotors, 0.0)
    elif flight.tells_now:
        controller.step(flight.stamp_s, x, now=flight.now_s)  # type: ignore[call-arg]
    else:
        controller.step(flight.stamp_s, x)
    raise FlightError(f"{type(controller).__name__}.step at t = {t:g} s: refused x = {x}")
