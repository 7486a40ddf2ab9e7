# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A closed-loop flight in one process, without ROS; the controller is handed in."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gtmr_model import ConfigError, YamlModel, airframe_clearance
from gtmr_sim.flying.log import FlightLog
from gtmr_sim.flying.native import fly_natively, native_step
from gtmr_sim.flying.stepwise import StepController, fly_stepwise
from gtmr_sim.scenario import Scenario, whole_steps
from gtmr_sim.simulation import Simulation

Array = NDArray[np.float64]

SAMPLING_TIME_S = 0.025
"""T_s of a controller that does not say [s] (Table I)."""
STEADY_S = 10.0
"""Over which time what is steady of a wind is averaged [s]: some three constants of a controller's
slowest answer."""
ROUNDING_N = 1e-9
"""By how much a force may exceed its bound and be within it [N]."""


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
    if hasattr(controller, "see_truth"):
        controller.see_truth(simulation)
    delay_s = scenario.world.odometry.delay_s
    tells_now = delay_s > 0.0 and "now" in inspect.signature(controller.step).parameters
    native = native_step(controller) if simulation.compiled is not None else None
    given = (tells_now, sampling_time_s, steps, on_step)
    rows = (
        fly_stepwise(simulation, controller, *given)
        if native is None
        else fly_natively(simulation, controller, native, *given)
    )
    steady = _moving_mean(rows.wind_n, round(STEADY_S / sampling_time_s))
    rest = np.linalg.norm(rows.wind_n - steady + rows.w_g, axis=1)
    bounds = scenario.uncertainty
    return FlightLog(
        **vars(rows),
        t=np.arange(steps) * round(sampling_time_s / scenario.step_s) * scenario.step_s,
        zeta=scenario.zeta_array,
        d_T=scenario.tower.clearance(rows.x),
        d_airframe=airframe_clearance(rows.x, scenario.vehicle, scenario.tower),
        least_clearance_m=simulation.least_clearance_m,
        steady_wind_within=_within(np.abs(steady), np.array(bounds.wind_bias_n)),
        gusts_within=_within(rest[:, None], np.array([bounds.gust_n])),
        sampling_time_s=sampling_time_s,
        mode=_name_of(controller),
        scenario=scenario,
    )


def _name_of(controller: StepController) -> str:
    """Say who flies: the mode of the suite's controller, or the class of another."""
    mode = getattr(controller, "mode", None)
    return mode if isinstance(mode, str) else type(controller).__name__


def _within(rows: Array, bounds: Array) -> float:
    """Share of the rows that are within the bounds in every column."""
    return float((rows <= bounds + ROUNDING_N).all(axis=1).mean())


def _moving_mean(rows: Array, window: int) -> Array:
    """Mean over the rows around each, as many on either side, fewer at the ends."""
    total = np.concatenate((np.zeros((1, rows.shape[1])), np.cumsum(rows, axis=0)))
    half, n = window // 2, len(rows)
    first = np.maximum(np.arange(n) - half, 0)
    last = np.minimum(np.arange(n) + half + 1, n)
    mean: Array = (total[last] - total[first]) / (last - first)[:, None]
    return mean


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
