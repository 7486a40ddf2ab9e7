"""The controller: a state in, a plan out; keeps the warm start from step to step."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_model.dynamics import YAW
from gtmr_nmpc import margins
from gtmr_nmpc.config import MODES, ControllerConfig, Mode
from gtmr_nmpc.rti import Preparation, RealTimeIteration, Trajectory
from gtmr_nmpc.solution import Solution, Timing

Array = NDArray[np.float64]

SLACK_TOLERANCE_M = 1e-9
"""Slack below this is rounding of the QP solver, not a violation [m]."""


class Controller:
    """Nominal or robust NMPC in real-time iteration.

    Parameters
    ----------
    config : ControllerConfig, optional
        The problem; the paper's with our defaults if left out.
    mode : str
        ``nominal`` for eq. (5) or ``robust`` for eq. (15). Both share one warm start, so that
        switching in flight makes no bump.

    Raises
    ------
    ValueError
        If the mode is unknown.
    """

    def __init__(self, config: ControllerConfig | None = None, mode: Mode = "robust") -> None:
        self.config = config if config is not None else ControllerConfig()
        self._rti = RealTimeIteration(self.config)
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
        self._prepared: tuple[float, float, Preparation] | None = None

    def reset(self) -> None:
        """Forget the warm start, as before the first step."""
        self._last: tuple[float, Trajectory] | None = None
        self._prepared = None

    def prepare(self, t: float) -> None:
        """Do all that can be done before the state at time t is known.

        Parameters
        ----------
        t : float
            When the next state will be measured [s]. Without a warm start there is nothing to
            prepare yet.
        """
        warm = self._shifted(t)
        if warm is not None:
            self._prepare(t, warm)

    def feedback(self, t: float, x: ArrayLike) -> Solution:
        """Plan from a measured state; fast if ``prepare`` was called for the same time.

        Parameters
        ----------
        t : float
            Time of the measurement [s].
        x : array_like, shape (12 + N_p,)
            State [p, eta, v, omega, xi]: m, rad, m/s, rad/s, Hz; yaw may be wrapped round.

        Returns
        -------
        Solution
            The plan, its margins, status and timing.

        Raises
        ------
        ValueError
            If x has the wrong shape or is not finite.
        """
        x = self._checked(t, x)
        if self._prepared is None or self._prepared[0] != t:
            self._prepare(t, self._shifted(t) or self._cold(x))
        assert self._prepared is not None
        _, prepare_s, prep = self._prepared
        self._prepared = None

        start = time.perf_counter()
        result = self._rti.feedback(prep, x)
        if result is None:
            trajectory, slack, status = prep.iterate, np.zeros(self.config.horizon), "failed"
        else:
            trajectory, slack = result
            status = "softened" if slack.max() > SLACK_TOLERANCE_M else "solved"
        self._last = (t, trajectory)
        # Stage 0 is measured, not planned: its violation is a fact and no variable of the QP.
        now = margins.tightened_residual(self.config.tower, x[None, :3], prep.margins.total[:1])
        return Solution(
            u=trajectory.u[0],
            x_plan=trajectory.x,
            u_plan=trajectory.u,
            alpha_p=prep.margins.parametric,
            alpha_p_by_channel=prep.margins.by_channel,
            eps_s=prep.margins.eps_s,
            alpha_g=prep.margins.gust,
            slack=np.r_[np.maximum(now, 0.0), slack],
            status=status,
            timing=Timing(prepare_s, time.perf_counter() - start),
        )

    def step(self, t: float, x: ArrayLike) -> Solution:
        """Prepare and plan in one call.

        Parameters
        ----------
        t : float
            Time of the measurement [s].
        x : array_like, shape (12 + N_p,)
            State [p, eta, v, omega, xi]: m, rad, m/s, rad/s, Hz; yaw may be wrapped round.

        Returns
        -------
        Solution
            The plan, its margins, status and timing.

        Raises
        ------
        ValueError
            If x has the wrong shape or is not finite.
        """
        return self.feedback(t, x)

    def _prepare(self, t: float, iterate: Trajectory) -> None:
        start = time.perf_counter()
        prep = self._rti.prepare(t, iterate, self._mode)
        self._prepared = (t, time.perf_counter() - start, prep)

    def _shifted(self, t: float) -> Trajectory | None:
        """Warm start for time t: the last plan from there on, the rotors then holding speed."""
        if self._last is None:
            return None
        last_t, plan = self._last
        shift = round((t - last_t) / self.config.sampling_time_s)
        if not 0 <= shift < self.config.horizon:
            return None
        hold = np.zeros((shift, self.config.vehicle.n_rotors))
        states = list(plan.x[shift:])
        for u in hold:
            states.append(self._rti.predict(states[-1], u))
        return Trajectory(x=np.array(states), u=np.vstack([plan.u[shift:], hold]))

    def _cold(self, x: Array) -> Trajectory:
        """Start from the state held for the whole horizon."""
        n = self.config.horizon
        return Trajectory(x=np.tile(x, (n + 1, 1)), u=np.zeros((n, self.config.vehicle.n_rotors)))

    def _checked(self, t: float, x: ArrayLike) -> Array:
        state = np.array(x, dtype=float)
        if state.shape != (self.config.vehicle.n_x,):
            raise ValueError(f"x has shape {state.shape}, expected ({self.config.vehicle.n_x},)")
        if not np.isfinite(state).all():
            raise ValueError(f"x is not finite: {state}")
        facing = self.config.helix.at(t, self.config.tower).yaw[0]
        state[YAW] += 2.0 * np.pi * np.round((facing - state[YAW]) / (2.0 * np.pi))
        return state
