# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Steps in C: all that a controller does between a state and its plan in one call."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_nmpc.compiled.iteration import STATUSES, CompiledIteration, Part
from gtmr_nmpc.config import ControllerConfig
from gtmr_nmpc.margins import Iterate, Tightening
from gtmr_nmpc.online.stepper import NativeStep, require_possible, shaped
from gtmr_nmpc.solution import Solution, Timing

Array = NDArray[np.float64]

NATIVE_PARTS = ("x_plan", "u_plan", "alpha_p", "alpha_g", "slack", "setpoints_hz")
"""What of a plan in C is what `Solution` says, in every mode."""


def margin_table(by_steps: Sequence[Tightening]) -> Array:
    """Write tightenings as ``gtmr_set_margins`` takes them, shape (K, 2, N + 1) [m]."""
    return np.array([[each.parametric, each.random] for each in by_steps])


class CompiledStepper:
    """A `Stepper` in C, in the memory of a compiled iteration, whose own phases rest."""

    def __init__(self, config: ControllerConfig, iteration: CompiledIteration) -> None:
        self._config, self._iteration = config, iteration
        self._library, self._controller = iteration.library, iteration.controller
        self._x = np.zeros(config.vehicle.n_x)
        self._shape = self._x.shape
        self._x_address = self._x.ctypes.data
        self._plan = np.zeros(iteration.sizes[1])
        self._plan_address = self._plan.ctypes.data
        self._call_step = self._library.gtmr_step
        self._parts = iteration.parts
        self._table = np.zeros(0)
        self._by_steps: Sequence[Tightening] = ()
        self._given: Tightening | None
        self._observes = False
        self.set_mode(0.0, 0.0)

    @property
    def last_s(self) -> float | None:
        """See `Stepper.last_s`."""
        last_s = float(self._library.gtmr_last_time(self._controller))
        return None if math.isnan(last_s) else last_s

    def reconfigure(self, config: ControllerConfig) -> None:
        """See `Stepper.reconfigure`."""
        self._config = config
        self._iteration.reconfigure(config)
        self._tell_eps_s()

    def set_mode(self, margin_scale: float, offset_free: float) -> None:
        """See `Stepper.set_mode`."""
        self._margin_scale, self._told_scale = margin_scale, max(margin_scale, offset_free)
        self._library.gtmr_set_mode(self._controller, margin_scale, offset_free)
        self._given = None
        self._tell_eps_s()

    def _tell_eps_s(self) -> None:
        eps_s_m = self._margin_scale * self._config.eps_s_m
        self._eps_s = np.full(self._config.horizon + 1, eps_s_m)

    def set_margins(self, by_steps: Sequence[Tightening]) -> None:
        """See `Stepper.set_margins`."""
        # The library keeps its address.
        self._by_steps, self._table = by_steps, margin_table(by_steps)
        address = ctypes.c_void_p(self._table.ctypes.data)
        self._library.gtmr_set_margins(self._controller, address, len(by_steps))

    def observes(self) -> None:
        """See `Stepper.observes`."""
        if not self._observes:
            self._observes = True
            self._iteration.observer()

    def reset(self) -> None:
        """See `Stepper.reset`."""
        self._library.gtmr_reset(self._controller)

    def begin(self, now: float, t: float = 0.0, x: ArrayLike | None = None) -> int:
        """See `Stepper.begin`."""
        if x is not None:
            self._take(x)
        address = None if x is None else self._x_address
        self._given = None
        steps: int = self._library.gtmr_begin(self._controller, t, address, now)
        if steps < 0 and x is not None:
            self._refuse(t, now)
        return steps

    def _take(self, x: ArrayLike) -> None:
        if type(x) is not np.ndarray or x.shape != self._shape:
            x = shaped(x, len(self._x))
        self._x[:] = x

    def _refuse(self, t: float, now: float) -> None:
        require_possible(t, self._x, now)
        raise AssertionError("a step was refused for no reason")

    def linearised(self) -> Iterate:
        """See `Stepper.linearised`."""
        return self._iteration.linearised()

    def tighten(self, tightening: Tightening) -> None:
        """See `Stepper.tighten`."""
        self._iteration.tighten(tightening)
        self._given = tightening

    def step(self, t: float, x: ArrayLike, now: float) -> Solution:
        """See `Stepper.step`."""
        self._take(x)
        status = self._call_step(self._controller, t, self._x_address, now, self._plan_address)
        if status < 0:
            self._refuse(t, now)
        margins = self._by_steps if self._given is None else (self._given,)
        self._given = None
        make = partial(_field, self._parts, self._plan.copy(), margins, self._eps_s)
        return Solution.later(make, self._told_scale, STATUSES[status])

    def native(self) -> NativeStep:
        """See `Stepper.native`."""
        function = ctypes.cast(self._library.gtmr_step, ctypes.c_void_p).value
        assert function is not None
        assert self._controller.value is not None
        return NativeStep(
            function=function,
            memory=self._controller.value,
            plan_length=len(self._plan),
            parts={name: self._parts[name] for name in NATIVE_PARTS},
            statuses=STATUSES,
        )


def _field(
    parts: dict[str, Part],
    plan: Array,
    margins: Sequence[Tightening],
    eps_s: Array,
    name: str,
) -> Any:
    """Make a field of a `Solution` out of a plan in C."""

    def part(of: str) -> Array:
        start, shape = parts[of]
        return np.ndarray(shape, float, plan, 8 * start)

    if name in parts:
        return part(name)
    if name == "u":
        return part("u_plan")[0]
    if name == "tightening":
        if margins:
            return margins[min(int(plan[parts["observed_steps"][0]]), len(margins) - 1)]
        return Tightening(part("alpha_p_by_channel"), eps_s, part("alpha_g"), np.zeros(len(eps_s)))
    if name == "timing":
        return Timing(*part("times_s").tolist())
    raise AttributeError(name)
