# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A closed-loop flight in one process, without ROS; the controller is handed in."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from gtmr_model import ConfigError, YamlModel
from gtmr_sim.scenario import Scenario, whole_steps
from gtmr_sim.simulation import Simulation

Array = NDArray[np.float64]

SAMPLING_TIME_S = 0.025
"""T_s of a controller that does not say [s] (Table I)."""


class FlightError(ValueError):
    """A controller gave what cannot be flown; the message is one line naming it and the time."""


class StepController(Protocol):
    """Anything that flies the vehicle."""

    def step(self, t: float, x: Array) -> Any:
        """Decide from state x, shape (12 + N_p,), at time t [s].

        Either rotor accelerations to hold until the next step [Hz/s], shape (N_p,), or an object
        whose ``u_plan``, shape (n, N_p), is played one row a sampling time. Such an object may
        also have ``alpha_p``, ``alpha_g``, ``slack``, ``status`` and ``timing.total_s`` as a
        `gtmr_nmpc.Solution` has them; what it has goes into the flight's log.
        """
        ...


@dataclass(frozen=True)
class FlightLog:
    """A flight, one row per controller step k at t_k = k T_s.

    What the controller does not tell is no number: its margins and slack have shape (K, 0), and
    ``failed`` has shape (0,).
    """

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
    """Time of step k [ms], shape (K,): the controller's own, else measured around ``step``."""
    failed: NDArray[np.bool_]
    """Whether the QP solver gave up in step k, shape (K,)."""
    guard: NDArray[np.bool_]
    """Whether the guard was in charge at the end of step k, shape (K,)."""

    @property
    def failed_steps(self) -> int | None:
        """In how many steps the QP solver gave up; None if the controller does not tell."""
        return int(self.failed.sum()) if self.failed.size else None

    @property
    def max_slack_m(self) -> float | None:
        """Largest slack of any stage and step [m]; None if the controller does not tell."""
        return float(self.slack.max()) if self.slack.size else None

    def save(self, file: Path | BinaryIO) -> None:
        """Write every field to a compressed npz file, by its path or already open."""
        np.savez_compressed(file, **{f.name: getattr(self, f.name) for f in fields(self)})


def fly(
    scenario: Scenario,
    controller: StepController,
    duration_s: float,
    sampling_time_s: float | None = None,
    on_step: Callable[[int], None] | None = None,
) -> FlightLog:
    """Fly one closed loop.

    Parameters
    ----------
    scenario : Scenario
        The world and the true parameters.
    controller : StepController
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
    FlightError
        If a step of the controller gives what cannot be flown.
    """
    config = getattr(controller, "config", None)
    own_period_s = getattr(config, "sampling_time_s", None)
    if sampling_time_s is None:
        sampling_time_s = SAMPLING_TIME_S if own_period_s is None else own_period_s
    _require_made_for(config, scenario, sampling_time_s)
    steps = whole_steps("duration_s", duration_s, "sampling_time_s", sampling_time_s)
    simulation = Simulation(scenario, sampling_time_s)
    times, states, gusts, guarded = [], [], [], []
    taken: list[_Step] = []
    for k in range(steps):
        t = simulation.time_s
        states.append(simulation.x)
        # A copy: what a controller does to its measurement must not reach the plant.
        x = simulation.x.copy()
        start = time.perf_counter()
        result = controller.step(t, x)
        elapsed_s = time.perf_counter() - start
        try:
            step = _Step.of(result, scenario.vehicle.n_rotors, elapsed_s)
            if taken and step.told != taken[0].told:
                raise ValueError(f"told {step.told}, in its first step {taken[0].told}")
        except (TypeError, ValueError) as error:
            name = type(controller).__name__
            raise FlightError(f"{name}.step at t = {t:g} s: {error}") from None
        times.append(t)
        gusts.append(simulation.gust_n)
        taken.append(step)
        simulation.command(t, step.u_plan)
        simulation.advance(sampling_time_s)
        guarded.append(simulation.guard_active)
        if on_step is not None:
            on_step(k + 1)
    x = np.array(states)
    told = [step.failed for step in taken if step.failed is not None]
    return FlightLog(
        t=np.array(times),
        x=x,
        u=np.array([step.u_plan[0] for step in taken]),
        zeta=scenario.zeta_array,
        w_g=np.array(gusts),
        d_T=scenario.tower.clearance(x),
        **{name: np.array([getattr(step, name) for step in taken]) for name in _BY_STAGE},
        solve_ms=np.array([step.solve_ms for step in taken]),
        failed=np.array(told, dtype=bool),
        guard=np.array(guarded, dtype=bool),
    )


_BY_STAGE = ("alpha_p", "alpha_g", "slack")


@dataclass(frozen=True)
class _Step:
    """What is kept of a controller's step; fields as in `FlightLog`, the whole plan apart."""

    u_plan: Array
    alpha_p: Array
    alpha_g: Array
    slack: Array
    solve_ms: float
    failed: bool | None

    @property
    def told(self) -> dict[str, Any]:
        """What the controller tells beside its plan; the same in every step of a flight."""
        shapes = {name: getattr(self, name).shape for name in _BY_STAGE}
        return {**shapes, "status": self.failed is not None}

    @classmethod
    def of(cls, result: Any, n_rotors: int, elapsed_s: float) -> _Step:
        """Read what ``step`` returned; raises ValueError or TypeError if it cannot be flown."""
        planned = hasattr(result, "u_plan")
        # Copies: the controller may use its arrays again.
        u = np.array(result.u_plan if planned else result, dtype=float)
        if planned and not (u.ndim == 2 and len(u) and u.shape[1] == n_rotors):
            raise ValueError(f"u_plan has shape {u.shape}, expected (n, {n_rotors})")
        if not planned and u.shape != (n_rotors,):
            raise ValueError(
                f"returned shape {u.shape}, expected ({n_rotors},), rotor accelerations [Hz/s]"
            )
        if not np.isfinite(u).all():
            raise ValueError(f"returned {u[~np.isfinite(u)][0]} among the rotor accelerations")
        stages = {name: getattr(result, name, None) for name in _BY_STAGE}
        status = getattr(result, "status", None)
        timing = getattr(result, "timing", None)
        return cls(
            u_plan=u.reshape(-1, n_rotors),
            **{k: np.array(() if v is None else v, dtype=float) for k, v in stages.items()},
            solve_ms=1e3 * (elapsed_s if timing is None else timing.total_s),
            failed=None if status is None else status == "failed",
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
