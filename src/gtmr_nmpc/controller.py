# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The controller: takes a state, returns a plan, and keeps the warm start between steps."""

import math
import time
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_codegen.library import CompileError, warn_interpreted
from gtmr_model.dynamics import PITCH, YAW
from gtmr_nmpc.closed_loop import deviations
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.config import MODES, ControllerConfig, Mode
from gtmr_nmpc.iteration import Iteration, IterationResult
from gtmr_nmpc.margins import (
    ClosedLoopMargin,
    Deviations,
    Iterate,
    Margin,
    PaperMargin,
    Tightening,
)
from gtmr_nmpc.margins.margin import tightening_of
from gtmr_nmpc.observer import GUST, N_THETA, Observer
from gtmr_nmpc.online.blend import Blend, between
from gtmr_nmpc.online.sent import Sent, setpoints
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_nmpc.solution import Solution, Timing

Array = NDArray[np.float64]

FIXED = ("vehicle", "horizon", "sampling_time_s", "tightening", "clearance_of")
"""Fields of the configuration that the controller is built for."""


class Controller:
    """Nominal, robust or offset-free NMPC in real-time iteration.

    Parameters
    ----------
    config : ControllerConfig, optional
        The problem; the paper's with our defaults if left out.
    mode : str
        ``nominal`` for eq. (5), ``robust`` for eq. (15), or ``offset_free``, which estimates the
        force and torque that act and keeps the margins of that closed loop. All share one warm
        start, and after a switch in flight what a mode has of its own comes in or goes over
        ``switch_time_s``, so that it makes no bump.

    iteration : Iteration, optional
        What solves the problem, made for ``config`` and used by this controller alone; compiled
        if left out, interpreted where there is no compiler.
    margin : Margin, optional
        A margin of your own, instead of ``config.margin``: any object with ``tightening``.

    Raises
    ------
    ValueError
        If the mode is unknown, or a margin of your own is to enter with its gradient.
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
        self._observer: Observer | None = None
        self._sent = Sent(self.config)
        self._share = 0.0
        self._by_step: list[Tightening] = []
        self._closed_loop: Deviations | None = None
        self._observed_t: float | None = None
        self._observed_steps = 0
        self.mode = mode
        self.reset()

    @property
    def mode(self) -> Mode:
        """``nominal``, ``robust`` or ``offset_free``; takes effect at the next step."""
        return self._mode

    @mode.setter
    def mode(self, mode: Mode) -> None:
        if mode not in MODES:
            raise ValueError(f"mode = {mode!r}: allowed is {' or '.join(MODES)}")
        self._mode: Mode = mode
        if mode == "offset_free":
            # What takes long is computed here, not in a step.
            self._deviations()
            self._observing()
        self._prepared: tuple[float, float, Blend] | None = None

    def reconfigure(self, config: ControllerConfig) -> None:
        """Take over other bounds, weights, clearance or slack penalties; keeps the warm start.

        Raises ValueError if vehicle, horizon or sampling time differ, which need a new controller.
        """
        for fixed in FIXED:
            if getattr(config, fixed) != getattr(self.config, fixed):
                raise ValueError(f"{fixed} cannot change in flight: make a new controller")
        problem = ControllerConfig.model_fields
        if all(getattr(config, name) == getattr(self.config, name) for name in problem):
            # The same problem, such as with another mode beside it: what took long stays valid.
            self.config = config
            return
        self._margin = self._chosen_margin(config)
        self.config = config
        self._sent.reconfigure(config)
        self._by_step, self._closed_loop = [], None
        self._iteration.reconfigure(self._blended(self._share))
        if self._mode == "offset_free":
            self._deviations()
        self._prepared = None

    def reset(self) -> None:
        """Forget the warm start, as before the first step."""
        self._last_t: float | None = None
        self._blend = Blend.of(self._mode)
        self._is_a_start = False
        self._prepared = None
        self._sent.reset()
        self._forget()

    def prepare(self, now: float) -> None:
        """Do all that can be done before a state is known; the command will act from ``now`` [s].

        Without a warm start there is nothing to prepare yet.
        """
        blend = self._take_shares(now)
        if self._warm(now):
            self._prepare(now, blend)

    def feedback(self, t: float, x: ArrayLike, now: float | None = None) -> Solution:
        """Plan from a measured state; fast if ``prepare`` was called for the same time.

        Parameters
        ----------
        t : float
            Time of the measurement, its stamp [s].
        x : array_like, shape (12 + N_p,)
            State [p, eta, v, omega, xi]: m, rad, m/s, rad/s, Hz; yaw may be wrapped.
        now : float, optional
            Time from which the command acts, and the plan begins [s]: the state is predicted up
            to it with the inputs that were sent. The stamp if left out.

        Raises
        ------
        ValueError
            If x has the wrong shape or is not finite, or ``now`` is no time from t on.
        """
        x = self._checked(t, x)
        now = t if now is None else now
        if not t <= now < math.inf:
            raise ValueError(f"now = {now}: the command cannot act before the stamp, {t}")
        if self._prepared is None or self._prepared[0] != now:
            blend = self._take_shares(now)
            # What the linearisation needs, roughly: the state is looked at closely below.
            if not self._warm(now):
                self._iteration.cold(x)
            self._prepare(now, blend)
        assert self._prepared is not None
        _, prepare_s, blend = self._prepared
        self._prepared = None

        start = time.perf_counter()
        x = self._present(t, x, now, blend.offset_free_scale)
        plan = self._iteration.feedback(x)
        setpoints_hz = setpoints(self.config, plan.x_plan, plan.u_plan)
        feedback_s = time.perf_counter() - start
        self._last_t, self._blend = now, blend
        self._is_a_start = plan.status != "failed" and self._is_sound(plan)
        if now > t or self.config.delay_s > 0.0:
            self._sent.add(now, t, plan.u_plan, setpoints_hz)
        return Solution(
            u=plan.u_plan[0],
            setpoints_hz=setpoints_hz,
            margin_scale=max(blend.margin_scale, blend.offset_free_scale),
            timing=Timing(prepare_s, feedback_s),
            x_plan=plan.x_plan,
            u_plan=plan.u_plan,
            tightening=plan.tightening,
            slack=plan.slack,
            status=plan.status,
        )

    def step(self, t: float, x: ArrayLike, now: float | None = None) -> Solution:
        """Prepare and plan in one call, with arguments and errors of `feedback`."""
        return self.feedback(t, x, now)

    def _take_shares(self, now: float) -> Blend:
        """Blend the modes: weights and disturbances of the next step."""
        switch_time_s = self.config.switch_time_s
        if self._last_t is None or switch_time_s == 0.0:
            blend = Blend.of(self._mode)
        else:
            most = max(0.0, now - self._last_t) / switch_time_s
            blend = self._blend.towards(self._mode, most)
        share = blend.offset_free_scale
        if share != self._share:
            self._share = share
            self._iteration.reconfigure(self._blended(share))
            if share == 0.0:
                self._iteration.disturb(None)
                self._forget()
        if share > 0.0:
            self._iteration.disturb(self._theta if share == 1.0 else share * self._theta)
        return blend

    def _blended(self, share: float) -> ControllerConfig:
        """Give the problem with this share of the weights of ``offset_free``."""
        config = self.config
        if share == 0.0:
            return config
        weights = between(config.weights, config.offset_free.weights, share)
        return config.model_copy(update={"weights": weights, "tightening": "frozen"})

    def _prepare(self, now: float, blend: Blend) -> None:
        start = time.perf_counter()
        scale, share = blend.margin_scale, blend.offset_free_scale
        self._iteration.prepare(now, scale)
        if share > 0.0:
            own = self._offset_free_tightening()
            own = own if share == 1.0 else own.scaled(share)
            if scale > 0.0:
                margin = self._margin or PaperMargin()
                own = own.plus(tightening_of(margin, self._iteration.linearised()).scaled(scale))
            self._iteration.tighten(own)
        elif self._margin is not None and scale > 0.0:
            own = tightening_of(self._margin, self._iteration.linearised())
            self._iteration.tighten(own.scaled(scale))
        self._prepared = (now, time.perf_counter() - start, blend)

    def _offset_free_tightening(self) -> Tightening:
        """Ask its margin; that of the closed loop depends on no plan, and is asked once."""
        margin, step = self.config.offset_free.margin, self._observed_steps
        if not isinstance(margin, ClosedLoopMargin):
            return tightening_of(margin, self._observed(step))
        if not self._by_step:
            steps = range(len(self._deviations().transient) + 1)
            at = self._observed(0)
            self._by_step = [tightening_of(margin, replace(at, observed_steps=k)) for k in steps]
        return self._by_step[min(step, len(self._by_step) - 1)]

    def _observed(self, steps: int) -> Iterate:
        """Tell a margin the iterate, and for how many steps disturbances have been estimated."""
        return replace(
            self._iteration.linearised(), deviations=self._deviations, observed_steps=steps
        )

    def _deviations(self) -> Deviations:
        if self._closed_loop is None:
            self._closed_loop = deviations(self.config)
        return self._closed_loop

    def _present(self, t: float, x: Array, now: float, share: float) -> Array:
        """Say where the vehicle is when the command acts, as measured or estimated."""
        if share == 0.0 and now == t:
            return x
        observer, measured = self._observing(), x
        if share > 0.0:
            dt_s = 0.0 if self._observed_t is None else t - self._observed_t
            begun = 0.0 < dt_s <= self.config.horizon * self.config.sampling_time_s
            self._observed_steps = self._observed_steps + 1 if begun else 0
            self._observed_t = t
            x, theta = observer.update(measured, dt_s)
            x[YAW] += math.tau * round((measured[YAW] - x[YAW]) / math.tau)
            # The next plan begins a sampling time later.
            until_s = now - t + self.config.sampling_time_s
            self._theta = theta
            self._theta[GUST] *= math.exp(
                -until_s / self.config.offset_free.disturbance.gust_time_s
            )
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
        self._observed_t, self._observed_steps = None, 0
        self._theta = np.zeros(N_THETA)
        if self._observer is not None:
            self._observer.reset()

    def _chosen_margin(self, config: ControllerConfig) -> Margin | None:
        """Choose the margin to ask; none is the paper's, which the iterations have themselves."""
        if self._own_margin is None:
            return None if isinstance(config.margin, PaperMargin) else config.margin
        if config.tightening == "gradient":
            raise ValueError("tightening = 'gradient': a margin of one's own enters 'frozen'")
        return self._own_margin

    def _is_sound(self, plan: IterationResult) -> bool:
        """Whether a plan stays where the model holds, and with it can be the next one's iterate.

        One step too long for the linearisation that it came from goes through the tower's axis, by
        the slack it needs, or through a pitch of 90 degrees, where Euler angles have no rates.
        """
        tower = self.config.tower
        reaches_axis = plan.slack.max() > tower.radius_m + tower.min_clearance_m
        pitch = plan.x_plan[:, PITCH].tolist()
        turns_over = not all(abs(angle) < math.pi / 2 for angle in pitch)
        return not reaches_axis and not turns_over

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
        # A sum is finite where all are, and faster than a look at each.
        if not math.isfinite(sum(state.tolist())):
            raise ValueError(f"x is not finite: {state}")
        facing = self.config.helix.facing(t, self.config.tower)
        turns = round((facing - float(state[YAW])) / math.tau)
        if turns != 0:
            state[YAW] += math.tau * turns
        return state


def fastest_iteration(config: ControllerConfig) -> Iteration:
    """Compile a problem, or interpret it where that cannot be."""
    try:
        return CompiledIteration(config)
    except CompileError as error:
        warn_interpreted(error)
        return InterpretedIteration(config)
