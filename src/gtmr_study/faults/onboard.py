# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Faults of the controller itself, and starts that no controller should meet."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gtmr_model.dynamics import ATTITUDE, POSITION, RATE, VELOCITY
from gtmr_nmpc import Controller, Solution
from gtmr_study.faults.links import CLEAR, COUNTED, D_MIN_M, KEEPS
from gtmr_study.faults.loop import (
    Action,
    Command,
    Disturbance,
    DisturbedFlight,
    Pilot,
    Sent,
    controller,
)


def kill(flight: DisturbedFlight) -> None:
    """End the controller's process."""
    flight.pilot = None


def start(flight: DisturbedFlight) -> None:
    """Start a new one, which knows nothing."""
    flight.pilot = Pilot(controller())


def reset_world(flight: DisturbedFlight) -> None:
    """Begin the same flight again under a controller that goes on."""
    flight.session.reset()


class FailingController:
    """A controller whose solver gives up, and which then says so and plans as it does."""

    def __init__(self, inner: Controller, rng: np.random.Generator, share: float) -> None:
        self.inner, self.rng, self.share = inner, rng, share

    def __getattr__(self, name: str) -> Any:
        """Be the other controller in all else."""
        return getattr(self.inner, name)

    def step(self, t: float, x: Any) -> Solution:
        """Plan, and sometimes fail: then the plan of before goes on, as in a failed step."""
        solution = self.inner.step(t, x)
        if self.rng.random() < self.share:
            u_plan = np.roll(solution.u_plan, -1, axis=0)
            u_plan[-1] = 0.0
            solution = replace(solution, status="failed", u_plan=0.0 * u_plan)
        return solution


def failing(share: float) -> Action:
    """Let the solver give up in a share of the steps."""

    def begin(flight: DisturbedFlight) -> None:
        if flight.pilot is not None:
            flight.pilot.controller = FailingController(controller(), flight.rng, share)

    return begin


def well_again(flight: DisturbedFlight) -> None:
    """Let the solver do its work again."""
    if flight.pilot is not None:
        flight.pilot.controller = controller()


def slow(flight: DisturbedFlight, message: Command) -> Sent:
    """Let a step take 20 to 200 ms, in which no other one is begun."""
    busy_until_s = flight.once("busy", dict)
    if flight.time_s < busy_until_s.get("s", 0.0):
        return []
    takes_s = float(flight.rng.uniform(0.02, 0.2))
    busy_until_s["s"] = flight.time_s + takes_s
    return [(takes_s, message)]


def placed(change: Callable[[DisturbedFlight, Any], None]) -> Action:
    """Put the vehicle somewhere else at once, state x of shape (12 + N_p,)."""

    def begin(flight: DisturbedFlight) -> None:
        x = flight.simulation.x.copy()
        change(flight, x)
        flight.simulation.plant.x = x

    return begin


def inverted(flight: DisturbedFlight, x: Any) -> None:
    """Roll it over, 2 m off the tower and 60 m up: to turn it again costs height."""
    x[POSITION][:2] *= 3.0 / np.hypot(*x[POSITION][:2])
    x[POSITION][2] += 40.0
    x[ATTITUDE][0] = np.pi + flight.rng.uniform(-0.5, 0.5)


def forbidden(flight: DisturbedFlight, x: Any) -> None:
    """Put it at rest between the tower's surface and d_min."""
    radius_m = flight.scenario.tower.radius_m + flight.rng.uniform(0.02, D_MIN_M)
    x[POSITION][:2] *= radius_m / np.hypot(*x[POSITION][:2])
    x[VELOCITY] = 0.0


def towards(flight: DisturbedFlight, x: Any) -> None:
    """Let it fly at the tower with 0.2 to 0.6 m/s."""
    outward = x[POSITION][:2] / np.hypot(*x[POSITION][:2])
    x[VELOCITY][:2] -= flight.rng.uniform(0.2, 0.6) * outward


def too_fast(flight: DisturbedFlight, x: Any) -> None:
    """Let it fly along its way with 3 to 8 m/s more."""
    along = x[VELOCITY][:2] / np.hypot(*x[VELOCITY][:2])
    x[VELOCITY][:2] += flight.rng.uniform(3.0, 8.0) * along


def spinning(flight: DisturbedFlight, x: Any) -> None:
    """Let it turn with up to 6 rad/s about each axis, 2 m off the tower."""
    x[POSITION][:2] *= 3.0 / np.hypot(*x[POSITION][:2])
    x[RATE] = flight.rng.uniform(-6.0, 6.0, 3)


AT_ONCE = (0.005, 0.005)

CONTROLLER: dict[str, tuple[str, Disturbance]] = {
    "nmpc-killed": (
        "stays clear of the tower for ever after, with the guard in charge",
        Disturbance((3.0, 6.0), begin=kill, guarded=True, recovers=False),
    ),
    "nmpc-restarted": (CLEAR, Disturbance((0.1, 3.0), begin=kill, end=start)),
    "solver-failing-half": (CLEAR, Disturbance(begin=failing(0.5), end=well_again)),
    "solver-failing": (CLEAR, Disturbance(begin=failing(1.0), end=well_again)),
    "nmpc-slow": (CLEAR, Disturbance(commanded=slow)),
    "world-reset": (KEEPS, Disturbance(AT_ONCE, begin=reset_world, least_m=D_MIN_M)),
    "start-inverted": (
        "stays clear of the tower and catches itself within 60 m of height",
        Disturbance(AT_ONCE, begin=placed(inverted), recovers=False),
    ),
    "start-forbidden": (CLEAR, Disturbance(AT_ONCE, begin=placed(forbidden))),
    "start-towards": (CLEAR, Disturbance(AT_ONCE, begin=placed(towards))),
    "start-too-fast": (
        "stays clear of the tower",
        Disturbance(AT_ONCE, begin=placed(too_fast), recovers=False),
    ),
    "start-spinning": (
        COUNTED,
        Disturbance(AT_ONCE, begin=placed(spinning), recovers=False),
    ),
}
"""By name: what is promised, and the disturbance."""
