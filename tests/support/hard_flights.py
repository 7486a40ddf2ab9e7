# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Closed-loop flights in which many inequalities of the QP are active."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gtmr_model import Vehicle
from gtmr_nmpc import ControllerConfig, Mode, Solution
from gtmr_sim import Scenario, Simulation

Array = NDArray[np.float64]
Step = Callable[[float, Array], Solution]

PAPER = Vehicle.paper()
WEAK = PAPER.model_copy(
    update={
        "min_rotor_speed_hz": 58.0,
        "max_rotor_speed_hz": 66.0,
        "max_rotor_acceleration_hz_s": 60.0,
    }
)
"""Rotors that are at a speed or acceleration limit most of the time."""


@dataclass(frozen=True)
class Situation:
    """Many short flights of one kind, each from another start."""

    mode: Mode
    config: ControllerConfig = field(default_factory=ControllerConfig)
    radial_m: tuple[float, float] = (0.0, 0.0)
    """Range of the start's offset from the helix, outward [m]."""
    radial_m_s: tuple[float, float] = (0.0, 0.0)
    """Range of the start's speed, outward, besides that along the helix [m/s]."""
    speed_m_s: float = 0.0
    """Most speed at the start in any direction [m/s]."""
    rotor_hz: float = 0.0
    """Most deviation of a rotor's speed from hover [Hz]."""
    at_rest: bool = False
    """Whether the vehicle starts without any speed."""
    gust: str = "ou"
    """Kind of gust."""
    steps: int = 40
    """Length of a flight."""
    active: tuple[str, ...] = ()
    """Which inequalities the flights are about: inputs, speeds, clearances, slacks."""

    def fly(self, step: Step, seed: int) -> Iterator[tuple[float, Array, Solution]]:
        """Fly once, step by step; gives time, state and solution of each."""
        rng = np.random.default_rng(seed)
        scenario = Scenario(
            vehicle=self.config.vehicle,
            zeta=(0.0,) * 6 + (-0.6, 0.4, 0.0),
            gust={"kind": self.gust},
            seed=seed,
            # The controller alone is meant.
            guard="hold",
        )
        simulation = Simulation(scenario, self.config.sampling_time_s)
        simulation.plant.x = self._start(simulation.x, rng)
        for k in range(self.steps):
            t, x = k * self.config.sampling_time_s, simulation.x
            solution = step(t, x)
            yield t, x, solution
            simulation.command(t, solution.u_plan)
            simulation.advance(self.config.sampling_time_s)

    def _start(self, x: Array, rng: np.random.Generator) -> Array:
        x = x.copy()
        x[0] += rng.uniform(*self.radial_m)
        if self.at_rest:
            x[6:12] = 0.0
        x[6] += rng.uniform(*self.radial_m_s)
        x[6:9] += rng.uniform(-self.speed_m_s, self.speed_m_s, 3)
        x[12:] += rng.uniform(-self.rotor_hz, self.rotor_hz, len(x) - 12)
        return x


GRADIENT = ControllerConfig(tightening="gradient")
CLOSE = {"radial_m": (-0.12, -0.02), "radial_m_s": (-0.5, 0.0), "gust": "worst-case"}
"""Starts at speed towards the tower that still can stop in time, most of them."""
SITUATIONS = {
    "calm": Situation("nominal"),
    "offset-free": Situation("offset_free", speed_m_s=0.3),
    "offset-free, clearance": Situation(
        "offset_free",
        radial_m=(-0.2, -0.1),
        radial_m_s=(-0.6, -0.4),
        active=("inputs", "clearances", "slacks"),
    ),
    "clearance, nominal": Situation("nominal", **CLOSE, active=("clearances",)),
    "clearance, frozen": Situation("robust", **CLOSE, active=("clearances",)),
    "clearance, gradient": Situation("robust", GRADIENT, **CLOSE, active=("clearances",)),
    "rotors at limits": Situation(
        "nominal",
        ControllerConfig(vehicle=WEAK),
        speed_m_s=0.3,
        rotor_hz=3.0,
        active=("inputs", "speeds"),
    ),
    "rotors beyond limits and clearance": Situation(
        "robust",
        ControllerConfig(vehicle=WEAK, tightening="gradient"),
        radial_m=(-0.15, 0.05),
        speed_m_s=0.3,
        rotor_hz=10.0,
        active=("inputs", "speeds", "clearances", "slacks"),
    ),
    "infeasible start": Situation(
        "robust",
        radial_m=(-0.25, -0.15),
        radial_m_s=(-0.6, -0.2),
        steps=20,
        active=("inputs", "clearances", "slacks"),
    ),
    "at rest in the forbidden zone": Situation(
        "robust",
        GRADIENT,
        radial_m=(-0.33, -0.16),
        at_rest=True,
        steps=20,
        active=("inputs", "clearances", "slacks"),
    ),
}


def random_starts(config, count):
    """States from inside the wall to far off, fast, with rotors within their limits and beyond."""
    rng = np.random.default_rng(5)
    starts = np.tile(config.helix.initial_state(config.tower, config.vehicle), (count, 1))
    for x in starts:
        x[:3] += rng.uniform(-0.4, 0.6, 3)
        x[3:5] += rng.uniform(-0.3, 0.3, 2)
        x[6:12] += rng.uniform(-1.0, 1.0, 6)
        x[12:] = rng.uniform(0.0, 120.0, 6)
    return starts
