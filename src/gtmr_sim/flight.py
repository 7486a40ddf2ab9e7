# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A closed-loop flight in one process, without ROS; the controller is handed in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gtmr_model import ConfigError, YamlModel
from gtmr_sim.scenario import Scenario, whole_steps
from gtmr_sim.simulation import Simulation

Array = NDArray[np.float64]

SAMPLING_TIME_S = 0.025
"""T_s of a controller that does not say [s] (Table I)."""


class Timing(Protocol):
    """How long a step took."""

    @property
    def total_s(self) -> float:
        """[s]."""
        ...


class Solution(Protocol):
    """What a controller's step returns; the members are read-only."""

    @property
    def u_plan(self) -> Array:
        """Planned rotor accelerations [Hz/s], shape (N, N_p)."""
        ...

    @property
    def alpha_p(self) -> Array:
        """Parametric margin per stage [m], shape (N + 1,)."""
        ...

    @property
    def alpha_g(self) -> Array:
        """Gust margin per stage [m], shape (N + 1,)."""
        ...

    @property
    def slack(self) -> Array:
        """Violation of the tightened clearance per stage [m], shape (N + 1,)."""
        ...

    @property
    def status(self) -> str:
        """``failed`` if no solution was found."""
        ...

    @property
    def timing(self) -> Timing:
        """How long the step took."""
        ...


class Controller(Protocol):
    """Anything that flies the vehicle: a plan for every state."""

    def step(self, t: float, x: Array) -> Solution:
        """Plan from state x at time t [s]."""
        ...


@dataclass(frozen=True)
class FlightLog:
    """A flight, one row per controller step k at t_k = k T_s."""

    t: Array
    """[s], shape (K,)."""
    x: Array
    """True state at t_k, shape (K, 12 + N_p)."""
    u: Array
    """Rotor accelerations commanded over [t_k, t_k + T_s) [Hz/s], shape (K, N_p)."""
    zeta: Array
    """True mismatch and wind bias, eq. (4), shape (9,)."""
    w_g: Array
    """Gust force held over [t_k, t_k + T_s), world frame [N], shape (K, 3)."""
    d_T: Array
    """Clearance at t_k [m], shape (K,)."""
    alpha_p: Array
    """Parametric margins of step k, eq. (12) [m], shape (K, N + 1)."""
    alpha_g: Array
    """Gust margins of step k, eq. (13) [m], shape (K, N + 1)."""
    slack: Array
    """Slack of step k [m], shape (K, N + 1)."""
    solve_ms: Array
    """Time of step k [ms], shape (K,)."""
    failed: NDArray[np.bool_]
    """Whether the QP solver gave up in step k, shape (K,)."""

    def save(self, path: Path) -> None:
        """Write every field to a compressed npz file.

        Parameters
        ----------
        path : pathlib.Path
            The file to write.
        """
        np.savez_compressed(path, **{f.name: getattr(self, f.name) for f in fields(self)})


def fly(
    scenario: Scenario,
    controller: Controller,
    duration_s: float,
    sampling_time_s: float | None = None,
    on_step: Callable[[int], None] | None = None,
) -> FlightLog:
    """Fly one closed loop.

    Parameters
    ----------
    scenario : Scenario
        The world and the true parameters.
    controller : Controller
        Starts cold: nothing of an earlier flight is used if it was reset.
    duration_s : float
        How long; a whole number of sampling times [s].
    sampling_time_s : float, optional
        T_s, time between two controller steps [s]; if left out that of the controller's
        ``config``, or 0.025 s where it has none.
    on_step : callable, optional
        Called with the number of steps done, for a progress bar.

    Raises
    ------
    ConfigError
        If a time is not what it must be, or the controller has a ``config`` made for another
        vehicle, tower, helix or sampling time.
    """
    config = getattr(controller, "config", None)
    own_period_s = getattr(config, "sampling_time_s", None)
    if sampling_time_s is None:
        sampling_time_s = SAMPLING_TIME_S if own_period_s is None else own_period_s
    _require_made_for(config, scenario, sampling_time_s)
    steps = whole_steps("duration_s", duration_s, "sampling_time_s", sampling_time_s)
    simulation = Simulation(scenario, sampling_time_s)
    times, states, gusts, solutions = [], [], [], []
    for k in range(steps):
        t = simulation.time_s
        solution = controller.step(t, simulation.x)
        times.append(t)
        states.append(simulation.x)
        gusts.append(simulation.gust_n)
        solutions.append(solution)
        simulation.command(t, solution.u_plan)
        simulation.advance(sampling_time_s)
        if on_step is not None:
            on_step(k + 1)
    x = np.array(states)
    return FlightLog(
        t=np.array(times),
        x=x,
        u=np.array([s.u_plan[0] for s in solutions]),
        zeta=scenario.zeta_array,
        w_g=np.array(gusts),
        d_T=scenario.tower.clearance(x),
        alpha_p=np.array([s.alpha_p for s in solutions]),
        alpha_g=np.array([s.alpha_g for s in solutions]),
        slack=np.array([s.slack for s in solutions]),
        solve_ms=1e3 * np.array([s.timing.total_s for s in solutions]),
        failed=np.array([s.status == "failed" for s in solutions]),
    )


def _require_made_for(config: object, scenario: Scenario, sampling_time_s: float) -> None:
    """Refuse a controller that believes in another world; what it does not say is taken as is."""
    world = {name: getattr(scenario, name) for name in ("vehicle", "tower", "helix")}
    for name, ours in {**world, "sampling_time_s": sampling_time_s}.items():
        theirs = getattr(config, name, ours)
        if isinstance(ours, YamlModel) and isinstance(theirs, type(ours)):
            for field in type(ours).model_fields:
                _require_equal(f"{name}.{field}", getattr(ours, field), getattr(theirs, field))
        else:
            _require_equal(name, ours, theirs)


def _require_equal(name: str, ours: object, theirs: object) -> None:
    if theirs != ours:
        raise ConfigError(f"{name} = {ours!r}: the controller is made for {theirs!r}")
