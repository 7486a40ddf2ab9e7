# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The controller: takes a state, returns a plan, and keeps the warm start between steps."""

import math
from dataclasses import replace

from numpy.typing import ArrayLike

from gtmr_codegen.library import CompileError, warn_interpreted
from gtmr_nmpc.closed_loop import deviations
from gtmr_nmpc.compiled.iteration import CompiledIteration
from gtmr_nmpc.compiled.stepper import CompiledStepper
from gtmr_nmpc.config import MODES, ControllerConfig, Mode
from gtmr_nmpc.iteration import Iteration
from gtmr_nmpc.margins import ClosedLoopMargin, Deviations, Margin, PaperMargin, Tightening
from gtmr_nmpc.margins.margin import tightening_of
from gtmr_nmpc.online.blend import WHOLLY, Blend, between
from gtmr_nmpc.online.stepper import IterationStepper, NativeStep, Stepper
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_nmpc.solution import Solution

FIXED = ("vehicle", "horizon", "sampling_time_s", "tightening", "clearance_of")
"""Fields of the configuration that the controller is built for."""

NOTHING = Blend(0.0, 0.0)
"""In force before the first step: no blend that becomes due, so that each is put in force."""


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
        self._stepper = _stepper(
            self.config, fastest_iteration(self.config) if iteration is None else iteration
        )
        self._closed_loop: Deviations | None = None
        self._by_steps: list[Tightening] = []
        self._in_force = NOTHING
        self._share = 0.0
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
            self._learn_closed_loop()
        self._prepared_for: float | None = None

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
        self._by_steps, self._closed_loop = [], None
        if self._mode == "offset_free":
            self._learn_closed_loop()
        self._stepper.reconfigure(self._blended(self._share))
        self._in_force, self._prepared_for = NOTHING, None

    def reset(self) -> None:
        """Forget the warm start, as before the first step."""
        self._blend = WHOLLY[self._mode]
        self._prepared_for = None
        self._stepper.reset()

    def prepare(self, now: float) -> None:
        """Do all that can be done before a state is known; the command will act from ``now`` [s].

        Without a warm start there is nothing to prepare yet.
        """
        self._put_due_in_force(now)
        self._prepare(now)

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
        now = t if now is None else now
        if self._prepared_for != now:
            self._put_due_in_force(now)
            if self._asks:
                self._prepare(now, t, x)
        solution = self._stepper.step(t, x, now)
        self._prepared_for, self._blend = None, self._in_force
        return solution

    def step(self, t: float, x: ArrayLike, now: float | None = None) -> Solution:
        """Prepare and plan in one call, with arguments and errors of `feedback`."""
        return self.feedback(t, x, now)

    def native(self) -> NativeStep | None:
        """Give the step as a function in C, for loops in C; steps from here and there may mix.

        None where a step is not wholly in C: without a compiler, with a margin other than the
        paper's and that of the closed loop, while a switch of the mode takes its time, and of a
        derived class or an object with methods of its own, which C would pass over.
        """
        if type(self) is not Controller or any(name in vars(Controller) for name in vars(self)):
            return None
        blend = self._next_blend(math.nan)
        if blend is not WHOLLY[self._mode]:
            return None
        self._put_due_in_force(math.nan)
        return None if self._asks else self._stepper.native()

    def _next_blend(self, now: float) -> Blend:
        """Blend the modes for a step at ``now`` [s]."""
        due = WHOLLY[self._mode]
        if self._blend is due:
            return due
        last_s, switch_time_s = self._stepper.last_s, self.config.switch_time_s
        if last_s is None or switch_time_s == 0.0:
            return due
        return self._blend.towards(self._mode, max(0.0, now - last_s) / switch_time_s)

    def _put_in_force(self, blend: Blend) -> None:
        """Let weights, margins and estimates of a blend act from the next step on."""
        scale, share = blend.margin_scale, blend.offset_free_scale
        if share != self._share:
            self._share = share
            self._stepper.reconfigure(self._blended(share))
        self._stepper.set_mode(scale, share)
        # What a margin says that depends on no plan is handed over, others are asked.
        is_known = share == 1.0 and scale == 0.0 and bool(self._known_by_steps())
        self._stepper.set_margins(self._by_steps if is_known else ())
        self._asks = (share > 0.0 and not is_known) or (scale > 0.0 and self._margin is not None)
        self._in_force = blend

    def _blended(self, share: float) -> ControllerConfig:
        """Give the problem with this share of the weights of ``offset_free``."""
        config = self.config
        if share == 0.0:
            return config
        weights = between(config.weights, config.offset_free.weights, share)
        return config.model_copy(update={"weights": weights, "tightening": "frozen"})

    def _put_due_in_force(self, now: float) -> None:
        blend = self._next_blend(now)
        if blend is not self._in_force:
            self._put_in_force(blend)

    def _prepare(self, now: float, t: float = 0.0, x: ArrayLike | None = None) -> None:
        """Prepare a step with what is in force, if there is a start: the last plan, or a state."""
        steps = self._stepper.begin(now, t, x)
        if steps < 0:
            return
        if self._asks:
            self._stepper.tighten(self._asked(self._in_force, steps))
        self._prepared_for = now

    def _asked(self, blend: Blend, steps: int) -> Tightening:
        """Ask the margins of a blend, so many steps after disturbances began to be estimated."""
        scale, share = blend.margin_scale, blend.offset_free_scale
        paper = self._margin or PaperMargin()
        if share == 0.0:
            return tightening_of(paper, self._stepper.linearised()).scaled(scale)
        known = self._known_by_steps()
        if known:
            own = known[min(steps, len(known) - 1)]
        else:
            at = replace(
                self._stepper.linearised(), deviations=self._deviations, observed_steps=steps
            )
            own = tightening_of(self.config.offset_free.margin, at)
        own = own if share == 1.0 else own.scaled(share)
        if scale > 0.0:
            own = own.plus(tightening_of(paper, self._stepper.linearised()).scaled(scale))
        return own

    def _learn_closed_loop(self) -> None:
        """Compute what takes long and the mode ``offset_free`` needs."""
        self._known_by_steps()
        self._deviations()
        self._stepper.observes()

    def _known_by_steps(self) -> list[Tightening]:
        """Ask the margin of the closed loop, which depends on no plan, once; none for others."""
        margin = self.config.offset_free.margin
        # A margin derived from it may depend on what it likes.
        if not self._by_steps and type(margin) is ClosedLoopMargin:
            self._by_steps = margin.by_steps(self.config, self._deviations())
        return self._by_steps

    def _deviations(self) -> Deviations:
        if self._closed_loop is None:
            self._closed_loop = deviations(self.config)
        return self._closed_loop

    def _chosen_margin(self, config: ControllerConfig) -> Margin | None:
        """Choose the margin to ask; none is the paper's, which the iterations have themselves."""
        if self._own_margin is None:
            return None if isinstance(config.margin, PaperMargin) else config.margin
        if config.tightening == "gradient":
            raise ValueError("tightening = 'gradient': a margin of one's own enters 'frozen'")
        return self._own_margin


def fastest_iteration(config: ControllerConfig) -> Iteration:
    """Compile a problem, or interpret it where that cannot be."""
    try:
        return CompiledIteration(config)
    except CompileError as error:
        warn_interpreted(error)
        return InterpretedIteration(config)


def _stepper(config: ControllerConfig, iteration: Iteration) -> Stepper:
    """Take the steps around an iteration, in C as well if it is the compiled one itself."""
    if type(iteration) is CompiledIteration:
        return CompiledStepper(config, iteration)
    return IterationStepper(config, iteration)
