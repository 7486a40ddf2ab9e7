# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What passes from one step to the next: warm or cold start, what is estimated, what was sent."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_model.dynamics import PITCH, YAW
from gtmr_nmpc.config import ControllerConfig
from gtmr_nmpc.iteration import Iteration, IterationResult
from gtmr_nmpc.margins import Iterate, Tightening
from gtmr_nmpc.observer import GUST, N_THETA, Observer
from gtmr_nmpc.online.sent import Sent, setpoints
from gtmr_nmpc.solution import Solution, Timing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NativeStep:
    """A controller's step for callers in C, with the memory of the controller itself.

    Valid as long as the controller lives and is neither reconfigured nor switched to another mode.
    """

    function: int
    """Address of ``int gtmr_step(void *, double t, const double *x, double now, double *plan)``;
    see ``gtmr.h``."""
    memory: int
    """Address of its first argument."""
    plan_length: int
    """Entries of ``plan``."""
    parts: dict[str, tuple[int, tuple[int, ...]]]
    """Where in ``plan`` an array begins, in entries, and its shape, by its name in `Solution`."""
    statuses: tuple[str, ...]
    """What it returns, as an index, by the names in `Solution`; negative if it refused to step."""


class Stepper(Protocol):
    """Steps of one problem; what passes from one to the next is its own."""

    @property
    def last_s(self) -> float | None:
        """Time from which the last plan acts [s]; None before the first step."""
        ...

    def reconfigure(self, config: ControllerConfig) -> None:
        """Take over other numbers of the same problem; the warm start stays."""
        ...

    def set_mode(self, margin_scale: float, offset_free: float) -> None:
        """Let the paper's margins and the mode ``offset_free`` apply, 0 to 1 each."""
        ...

    def set_margins(self, by_steps: Sequence[Tightening]) -> None:
        """Tighten by entry k in the step k after disturbances began to be estimated.

        The last one is for all after it; none for the paper's margins, or those of ``tighten``.
        """
        ...

    def observes(self) -> None:
        """Compute what takes long, before the mode ``offset_free``."""
        ...

    def reset(self) -> None:
        """Forget everything: the next step is the first."""
        ...

    def begin(self, now: float, t: float = 0.0, x: ArrayLike | None = None) -> int:
        """Do all that needs no state, for a plan that acts from ``now`` on [s].

        Starts from the last plan, or else a state, if one is given with its stamp t. Done for the
        same ``now`` and still valid, it is not done again. Returns how many steps ago disturbances
        began to be estimated, -1 if there is no start. Errors as of ``step``.
        """
        ...

    def linearised(self) -> Iterate:
        """See `Iteration.linearised`."""
        ...

    def tighten(self, tightening: Tightening) -> None:
        """See `Iteration.tighten`."""
        ...

    def step(self, t: float, x: ArrayLike, now: float) -> Solution:
        """Plan from a state measured at t, to act from ``now`` on [s]; begins if need be.

        Raises ValueError if x has the wrong shape or is not finite, or ``now`` is no time from t
        on.
        """
        ...

    def native(self) -> NativeStep | None:
        """Give the whole of it to callers in C; None if it is not in C."""
        ...


def shaped(x: ArrayLike, n_x: int) -> Array:
    """Make an array of a state; ValueError if its shape is another than (n_x,)."""
    state = np.array(x, dtype=float)
    if state.shape != (n_x,):
        raise ValueError(f"x has shape {state.shape}, expected ({n_x},)")
    return state


def require_possible(t: float, x: Array, now: float) -> None:
    """Raise ValueError if x is not finite, or ``now`` is no time from t on."""
    # A sum is finite where all are, and faster than a look at each.
    if not math.isfinite(sum(x.tolist())):
        raise ValueError(f"x is not finite: {x}")
    if not t <= now < math.inf:
        raise ValueError(f"now = {now}: the command cannot act before the stamp, {t}")


class IterationStepper:
    """A `Stepper` in Python, around any `Iteration`."""

    def __init__(self, config: ControllerConfig, iteration: Iteration) -> None:
        self._config, self._iteration = config, iteration
        self._observer: Observer | None = None
        self._sent = Sent(config)
        self._margin_scale = self._offset_free = 0.0
        self._by_steps: Sequence[Tightening] = ()
        self._last_s: float | None
        self._prepared_for: float | None
        self._observed_s: float | None
        self._observed_steps: int
        self._theta: Array
        self.reset()

    @property
    def last_s(self) -> float | None:
        """See `Stepper.last_s`."""
        return self._last_s

    def reconfigure(self, config: ControllerConfig) -> None:
        """See `Stepper.reconfigure`."""
        self._config = config
        self._sent.reconfigure(config)
        self._iteration.reconfigure(config)
        self._prepared_for = None

    def set_mode(self, margin_scale: float, offset_free: float) -> None:
        """See `Stepper.set_mode`."""
        if offset_free == 0.0 and self._offset_free != 0.0:
            self._iteration.disturb(None)
            self._forget()
        self._margin_scale, self._offset_free = margin_scale, offset_free
        self._prepared_for = None

    def set_margins(self, by_steps: Sequence[Tightening]) -> None:
        """See `Stepper.set_margins`."""
        self._by_steps = by_steps
        self._prepared_for = None

    def observes(self) -> None:
        """See `Stepper.observes`."""
        self._observing()

    def reset(self) -> None:
        """See `Stepper.reset`."""
        self._last_s = None
        self._is_a_start = False
        self._prepared_for = None
        self._sent.reset()
        self._forget()

    def begin(self, now: float, t: float = 0.0, x: ArrayLike | None = None) -> int:
        """See `Stepper.begin`."""
        state = None if x is None else self._taken(t, x, now)
        if self._prepared_for == now:
            return self._observed_steps
        self._began_s = time.perf_counter()
        if self._offset_free > 0.0:
            self._iteration.disturb(self._offset_free * self._theta)
        if not self._warm(now):
            if state is None:
                return -1
            # What the linearisation needs, roughly: the state is looked at closely later.
            self._iteration.cold(state)
        self._iteration.prepare(now, self._margin_scale)
        self._prepared_for = now
        if self._by_steps:
            self._iteration.tighten(
                self._by_steps[min(self._observed_steps, len(self._by_steps) - 1)]
            )
        self._prepare_s = time.perf_counter() - self._began_s
        return self._observed_steps

    def _taken(self, t: float, x: ArrayLike, now: float) -> Array:
        """Check a state, and turn its yaw to within pi of the reference's."""
        config = self._config
        state = shaped(x, config.vehicle.n_x)
        require_possible(t, state, now)
        turns = round((config.helix.facing(t, config.tower) - float(state[YAW])) / math.tau)
        state[YAW] += math.tau * turns
        return state

    def linearised(self) -> Iterate:
        """See `Stepper.linearised`."""
        return self._iteration.linearised()

    def tighten(self, tightening: Tightening) -> None:
        """See `Stepper.tighten`."""
        self._iteration.tighten(tightening)
        self._prepare_s = time.perf_counter() - self._began_s

    def step(self, t: float, x: ArrayLike, now: float) -> Solution:
        """See `Stepper.step`."""
        self.begin(now, t, x)
        start = time.perf_counter()
        plan = self._iteration.feedback(self._present(t, self._taken(t, x, now), now))
        setpoints_hz = setpoints(self._config, plan.x_plan, plan.u_plan)
        feedback_s = time.perf_counter() - start
        self._last_s, self._prepared_for = now, None
        self._is_a_start = plan.status != "failed" and self._is_sound(plan)
        if now > t or self._config.delay_s > 0.0:
            self._sent.add(now, t, plan.u_plan, setpoints_hz)
        return Solution(
            u=plan.u_plan[0],
            setpoints_hz=setpoints_hz,
            margin_scale=max(self._margin_scale, self._offset_free),
            timing=Timing(self._prepare_s, feedback_s),
            x_plan=plan.x_plan,
            u_plan=plan.u_plan,
            tightening=plan.tightening,
            slack=plan.slack,
            status=plan.status,
        )

    def native(self) -> None:
        """See `Stepper.native`."""

    def _present(self, t: float, x: Array, now: float) -> Array:
        """Say where the vehicle is when the command acts, as measured or estimated."""
        share, measured = self._offset_free, x
        if share == 0.0 and now == t:
            return x
        observer = self._observing()
        if share > 0.0:
            config = self._config
            dt_s = 0.0 if self._observed_s is None else t - self._observed_s
            begun = 0.0 < dt_s <= config.horizon * config.sampling_time_s
            self._observed_steps = self._observed_steps + 1 if begun else 0
            self._observed_s = t
            x, theta = observer.update(measured, dt_s)
            x[YAW] += math.tau * round((measured[YAW] - x[YAW]) / math.tau)
            # The next plan begins a sampling time later.
            until_s = now - t + config.sampling_time_s
            self._theta = theta
            self._theta[GUST] *= math.exp(-until_s / config.offset_free.disturbance.gust_time_s)
        if now > t:
            x = self._sent.ahead(observer, x, t, now)
            if 0.0 < share < 1.0:
                measured = self._sent.ahead(observer, measured, t, now)
        return x if share in (0.0, 1.0) else (1.0 - share) * measured + share * x

    def _observing(self) -> Observer:
        if self._observer is None:
            self._observer = self._iteration.observer()
        return self._observer

    def _forget(self) -> None:
        """Let the observer begin anew."""
        self._observed_s = None
        self._observed_steps = 0
        self._theta = np.zeros(N_THETA)
        if self._observer is not None:
            self._observer.reset()

    def _is_sound(self, plan: IterationResult) -> bool:
        """Whether a plan stays where the model holds, and with it can be the next one's iterate.

        One step too long for the linearisation that it came from goes through the tower's axis, by
        the slack it needs, or through a pitch of 90 degrees, where Euler angles have no rates.
        """
        tower = self._config.tower
        reaches_axis = plan.slack.max() > tower.radius_m + tower.min_clearance_m
        pitch = plan.x_plan[:, PITCH].tolist()
        turns_over = not all(abs(angle) < math.pi / 2 for angle in pitch)
        return not reaches_axis and not turns_over

    def _warm(self, now: float) -> bool:
        """Start from the last plan, if it reaches a time and is fit for it."""
        if self._last_s is None or not self._is_a_start:
            return False
        steps = round((now - self._last_s) / self._config.sampling_time_s)
        if not 0 <= steps < self._config.horizon:
            return False
        self._iteration.warm(steps)
        return True
