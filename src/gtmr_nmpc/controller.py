# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The controller: a state in, a plan out; keeps the warm start from step to step."""

import math
import time

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_codegen.library import CompileError, warn_interpreted
from gtmr_model.dynamics import PITCH, YAW
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.config import MODES, ControllerConfig, Mode
from gtmr_nmpc.iteration import Iteration, IterationResult
from gtmr_nmpc.margins import Margin, PaperMargin
from gtmr_nmpc.margins.margin import tightening_of
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_nmpc.solution import Solution, Timing

Array = NDArray[np.float64]

FIXED = ("vehicle", "horizon", "sampling_time_s", "tightening")
"""Fields of the configuration that the controller is built for."""


class Controller:
    """Nominal or robust NMPC in real-time iteration.

    Parameters
    ----------
    config : ControllerConfig, optional
        The problem; the paper's with our defaults if left out.
    mode : str
        ``nominal`` for eq. (5) or ``robust`` for eq. (15). Both share one warm start, and after a
        switch in flight the margins come in or go over ``switch_time_s``, so that it makes no
        bump.

    iteration : Iteration, optional
        What solves the problem, made for ``config`` and used by this controller alone; compiled
        if left out, interpreted where there is no compiler.
    margin : Margin, optional
        A margin of one's own, instead of ``config.margin``: anything with its ``tightening``.

    Raises
    ------
    ValueError
        If the mode is unknown, or a margin of one's own is to enter with its gradient.
    """

    def __init__(
        self,
        config: ControllerConfig | None = None,
        mode: Mode = "robust",
        iteration: Iteration | None = None,
        margin: Margin | None = None,
    ) -> None:
        self.config = config if config is not None else ControllerConfig()
        self._own_margin = margin
        self._margin = self._chosen_margin(self.config)
        self._iteration = iteration if iteration is not None else fastest_iteration(self.config)
        self.mode = mode
        self.reset()

    @property
    def mode(self) -> Mode:
        """``nominal`` or ``robust``; takes effect at the next step."""
        return self._mode

    @mode.setter
    def mode(self, mode: Mode) -> None:
        if mode not in MODES:
            raise ValueError(f"mode = {mode!r}: allowed is {' or '.join(MODES)}")
        self._mode: Mode = mode
        self._prepared: tuple[float, float, float] | None = None

    def reconfigure(self, config: ControllerConfig) -> None:
        """Take over other bounds, weights, clearance or slack penalties; keeps the warm start.

        Raises ValueError if vehicle, horizon or sampling time differ, which need a new controller.
        """
        for fixed in FIXED:
            if getattr(config, fixed) != getattr(self.config, fixed):
                raise ValueError(f"{fixed} cannot change in flight: make a new controller")
        self._margin = self._chosen_margin(config)
        self.config = config
        self._iteration.reconfigure(config)
        self._prepared = None

    def reset(self) -> None:
        """Forget the warm start, as before the first step."""
        self._last_t: float | None = None
        self._last_progress = 0.0
        self._is_a_start = False
        self._prepared = None

    def prepare(self, t: float) -> None:
        """Do all that can be done before the state at time t [s] is known.

        Without a warm start there is nothing to prepare yet.
        """
        if self._warm(t):
            self._prepare(t)

    def feedback(self, t: float, x: ArrayLike) -> Solution:
        """Plan from a measured state; fast if ``prepare`` was called for the same time.

        Parameters
        ----------
        t : float
            Time of the measurement [s].
        x : array_like, shape (12 + N_p,)
            State [p, eta, v, omega, xi]: m, rad, m/s, rad/s, Hz; yaw may be wrapped round.

        Raises
        ------
        ValueError
            If x has the wrong shape or is not finite.
        """
        x = self._checked(t, x)
        if self._prepared is None or self._prepared[0] != t:
            if not self._warm(t):
                self._iteration.cold(x)
            self._prepare(t)
        assert self._prepared is not None
        _, prepare_s, progress = self._prepared
        self._prepared = None

        start = time.perf_counter()
        plan = self._iteration.feedback(x)
        feedback_s = time.perf_counter() - start
        self._last_t, self._last_progress = t, progress
        self._is_a_start = plan.status != "failed" and self._is_sound(plan)
        return Solution(
            u=plan.u_plan[0],
            margin_scale=_margin_scale(progress),
            timing=Timing(prepare_s, feedback_s),
            **plan._asdict(),
        )

    def step(self, t: float, x: ArrayLike) -> Solution:
        """Prepare and plan in one call, with arguments and errors of `feedback`."""
        return self.feedback(t, x)

    def _prepare(self, t: float) -> None:
        start = time.perf_counter()
        progress = self._margin_progress(t)
        scale = _margin_scale(progress)
        self._iteration.prepare(t, scale)
        if self._margin is not None and scale > 0.0:
            own = tightening_of(self._margin, self._iteration.linearised())
            self._iteration.tighten(own.scaled(scale))
        self._prepared = (t, time.perf_counter() - start, progress)

    def _chosen_margin(self, config: ControllerConfig) -> Margin | None:
        """Choose the margin to ask; none is the paper's, which the iterations have themselves."""
        if self._own_margin is None:
            return None if isinstance(config.margin, PaperMargin) else config.margin
        if config.tightening == "gradient":
            raise ValueError("tightening = 'gradient': a margin of one's own enters 'frozen'")
        return self._own_margin

    def _margin_progress(self, t: float) -> float:
        """How far the margins have come in at time t: they come and go over the switch time."""
        due = 1.0 if self._mode == "robust" else 0.0
        switch_time_s = self.config.switch_time_s
        if self._last_t is None or switch_time_s == 0.0:
            return due
        most = max(0.0, t - self._last_t) / switch_time_s
        return self._last_progress + min(max(due - self._last_progress, -most), most)

    def _is_sound(self, plan: IterationResult) -> bool:
        """Whether a plan stays where the model holds, and with it can be the next one's iterate.

        One step too long for the linearisation that it came from goes through the tower's axis, by
        the slack it needs, or through a pitch of 90 degrees, where Euler angles have no rates.
        """
        tower = self.config.tower
        reaches_axis = plan.slack.max() > tower.radius_m + tower.min_clearance_m
        return bool(not reaches_axis and np.abs(plan.x_plan[:, PITCH]).max() < math.pi / 2)

    def _warm(self, t: float) -> bool:
        """Start from the last plan, if it reaches time t and is fit for it."""
        if self._last_t is None or not self._is_a_start:
            return False
        steps = round((t - self._last_t) / self.config.sampling_time_s)
        if not 0 <= steps < self.config.horizon:
            return False
        self._iteration.warm(steps)
        return True

    def _checked(self, t: float, x: ArrayLike) -> Array:
        state = np.array(x, dtype=float)
        if state.shape != (self.config.vehicle.n_x,):
            raise ValueError(f"x has shape {state.shape}, expected ({self.config.vehicle.n_x},)")
        if not np.isfinite(state).all():
            raise ValueError(f"x is not finite: {state}")
        facing = self.config.helix.facing(t, self.config.tower)
        state[YAW] += math.tau * round((facing - state[YAW]) / math.tau)
        return state


def _margin_scale(progress: float) -> float:
    """Begin and end gently: a margin that grows at once at full rate is a jerk of its own."""
    return progress * progress * (3.0 - 2.0 * progress)


def fastest_iteration(config: ControllerConfig) -> Iteration:
    """Compile a problem, or interpret it where that cannot be."""
    try:
        return CompiledIteration(config)
    except CompileError as error:
        warn_interpreted(error)
        return InterpretedIteration(config)
