# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The states that every contender is given."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gtmr_model import ConfigError
from gtmr_nmpc import Controller
from gtmr_sim import GustConfig, Scenario, Simulation
from gtmr_study.paper.claims import FIG_1_ZETA

Array = NDArray[np.float64]

WARM_UP_STEPS = 20
"""Steps before timing starts, not counted."""


@dataclass(frozen=True)
class Situation:
    """Recorded states that every contender is given."""

    name: str
    """What goes on."""
    steps: list[tuple[float, Array]]
    """Time [s] and state of each step; time falls back to zero where a flight starts anew."""


def record_situations(steps: int) -> list[Situation]:
    """Fly what the contenders are timed on.

    Calm flight; wind with gusts towards the tower, where the tightened clearance is active much of
    the time; starts from far off, where rotor limits and slacks are. No guard interferes.
    """
    windy = Scenario(zeta=FIG_1_ZETA, gust=GustConfig(kind="worst-case"), guard="hold")
    return [
        Situation(
            "calm", list(_flight(Scenario(gust=GustConfig(kind="none"), guard="hold"), steps))
        ),
        Situation("at the limit", list(_flight(windy, steps))),
        Situation("recovery", list(_recoveries(Scenario(guard="hold"), steps))),
    ]


def _flight(
    scenario: Scenario, steps: int, x0: Array | None = None
) -> Iterator[tuple[float, Array]]:
    simulation, controller = Simulation(scenario, 0.025), Controller()
    if x0 is not None:
        simulation.plant.x = x0
    for _ in range(steps):
        t, x = simulation.time_s, simulation.x
        yield t, x
        simulation.command(t, controller.step(t, x).u_plan)
        simulation.advance(0.025)


def _recoveries(scenario: Scenario, steps: int) -> Iterator[tuple[float, Array]]:
    """Short flights from random starts: off the helix, too close, at rest, rotors off hover."""
    rng = np.random.default_rng(0)
    start = scenario.helix.initial_state(scenario.tower, scenario.vehicle)
    for first in range(0, steps, 40):
        x = start.copy()
        x[:3] += rng.uniform([-0.25, -0.2, -0.2], [0.4, 0.2, 0.2])
        x[3:5] += rng.uniform(-0.2, 0.2, 2)
        x[6:9] = rng.uniform(-0.6, 0.6, 3) * (rng.random() < 0.7)
        x[12:] += rng.uniform(-25.0, 25.0, len(x) - 12)
        yield from _flight(scenario, min(40, steps - first), x)


def in_flight(situation: Situation, reset: Callable[[], None]) -> Iterator[tuple[float, Array]]:
    """Go through the states; where a flight starts anew, the warm start is dropped."""
    last = np.inf
    for t, x in situation.steps:
        if t < last:
            reset()
        last = t
        yield t, x


def percentiles(seconds: list[float]) -> dict[str, float]:
    """Median, p99, p99.9 and maximum [ms] of times [s]."""
    if not seconds:
        raise ConfigError(f"steps: allowed is more than {WARM_UP_STEPS}")
    quantiles = np.percentile(seconds, [50.0, 99.0, 99.9, 100.0])
    median, p99, p999, most = (1e3 * float(value) for value in quantiles)
    return {"median": median, "p99": p99, "p99.9": p999, "max": most}
