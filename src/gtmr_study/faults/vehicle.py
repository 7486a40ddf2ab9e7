# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Faults of the vehicle and its world: rotors, and what lies outside the controller's bounds."""

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import null_space

from gtmr_model import Tower, UncertaintySet, Vehicle
from gtmr_model.dynamics import ATTITUDE, ROTORS, rotation
from gtmr_model.vehicle import GRAVITY_M_S2
from gtmr_sim import GustConfig, Scenario
from gtmr_sim.plant import Effect, Plant
from gtmr_study.faults.fault import Rng
from gtmr_study.faults.links import COUNTED
from gtmr_study.faults.loop import Action, Disturbance, DisturbedFlight, world


@lru_cache(maxsize=64)
def weak_rotor(rotor: int, share: float) -> Effect:
    """Make the effect of a rotor that gives only a share of its thrust and drag torque."""

    def weak(x: Any, zeta: Any, vehicle: Vehicle, _: Tower) -> tuple[Any, Any]:
        missing = (share - 1.0) * (1.0 + zeta[4]) * x[ROTORS][rotor] ** 2
        wrench = ca.DM(vehicle.allocation[:, rotor]) * missing
        return rotation(x[ATTITUDE]) @ wrench[:3], wrench[3:]

    return weak


class StuckRotorPlant(Plant):
    """A plant with a rotor that holds its speed, whatever is commanded."""

    rotor = 0

    def advance(self, u: ArrayLike, w_g: ArrayLike, steps: int) -> None:
        """Fly on as a plant does."""
        commanded = np.array(u, dtype=float)
        commanded[self.rotor] = 0.0
        super().advance(commanded, w_g, steps)


def weaken(share: float) -> Action:
    """Leave a rotor, which one is drawn, only a share of its thrust."""

    def begin(flight: DisturbedFlight) -> None:
        rotor = int(flight.rng.integers(flight.scenario.vehicle.n_rotors))
        flight.simulation.plant = _plant(Plant, flight, (weak_rotor(rotor, share),))

    return begin


def stick(flight: DisturbedFlight) -> None:
    """Let a rotor, which one is drawn, hold its speed from now on."""
    plant = _plant(StuckRotorPlant, flight, ())
    plant.rotor = int(flight.rng.integers(flight.scenario.vehicle.n_rotors))
    flight.simulation.plant = plant


def _plant(kind: type[Any], flight: DisturbedFlight, effects: tuple[Effect, ...]) -> Any:
    scenario, old = flight.scenario, flight.simulation.plant
    return kind(scenario.vehicle, old.zeta, old.x, scenario.step_s, scenario.tower, effects)


def hover_without(vehicle: Vehicle, rotor: int) -> tuple[float, NDArray[np.float64]] | None:
    """Find a hover on the rotors but one: its tilt [rad] and their speeds [Hz].

    Without it the allocation has rank 5: force and torque can no longer be chosen freely, but a
    vehicle may still hover in one attitude, tilted so that what force there is without torque
    points up. Of those that keep the speed limits the one with the slowest fastest rotor is
    given, shape (N_p - 1,); None if there is none.
    """
    allocation = np.delete(vehicle.allocation, rotor, axis=1)
    weight_n = vehicle.mass_kg * GRAVITY_M_S2
    # Squared speeds without torque are a plane; go around it.
    plane = null_space(allocation[3:])
    angles = np.linspace(0.0, 2.0 * np.pi, 3601)
    squared = plane @ np.array([np.cos(angles), np.sin(angles)])
    force = allocation[:3] @ squared
    scale = weight_n / np.linalg.norm(force, axis=0)
    squared, force = scale * squared, scale * force
    low, high = vehicle.min_rotor_speed_hz**2, vehicle.max_rotor_speed_hz**2
    kept = np.flatnonzero(((squared >= low) & (squared <= high)).all(axis=0) & (force[2] > 0.0))
    if kept.size == 0:
        return None
    best = kept[np.argmin(squared[:, kept].max(axis=0))]
    return float(np.arccos(force[2, best] / weight_n)), np.sqrt(squared[:, best])


def beyond(factor: float, **which: Any) -> Any:
    """Make a world whose gusts, wind or mass go beyond the bounds that the controller knows."""

    def choose(rng: Rng) -> Scenario:
        scenario = world(rng)
        known = UncertaintySet()
        wider = known.model_copy(update={name: _times(factor, known, name) for name in which})
        zeta = np.array(scenario.zeta)
        if "mass" in which:
            zeta[0] = rng.choice([-1.0, 1.0]) * wider.mass
        if "wind_bias_n" in which:
            zeta[6:] = factor * known.half_widths[6:] * rng.choice([-1.0, 1.0], 3)
        gust = GustConfig(std_n=factor * 0.25) if "gust_n" in which else scenario.gust
        return scenario.model_copy(
            update={"uncertainty": wider, "zeta": tuple(zeta.tolist()), "gust": gust}
        )

    return choose


def _times(factor: float, known: UncertaintySet, name: str) -> Any:
    value = getattr(known, name)
    return tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value


CLEAR_ONLY = "stays clear of the tower"
FOR_GOOD = (3.0, 6.0)

VEHICLE: dict[str, tuple[str, Disturbance]] = {
    "rotor-at-80": (CLEAR_ONLY, Disturbance(FOR_GOOD, begin=weaken(0.8), recovers=False)),
    "rotor-at-50": (COUNTED, Disturbance(FOR_GOOD, begin=weaken(0.5), recovers=False)),
    "rotor-at-0": (COUNTED, Disturbance(FOR_GOOD, begin=weaken(0.0), recovers=False)),
    "rotor-stuck": (COUNTED, Disturbance(FOR_GOOD, begin=stick, recovers=False)),
    "gust-twice-its-bound": (
        CLEAR_ONLY,
        Disturbance(FOR_GOOD, scenario=beyond(2.0, gust_n=True), recovers=False),
    ),
    "wind-twice-its-bound": (
        CLEAR_ONLY,
        Disturbance(FOR_GOOD, scenario=beyond(2.0, wind_bias_n=True), recovers=False),
    ),
    "mass-30-off": (
        CLEAR_ONLY,
        Disturbance(FOR_GOOD, scenario=beyond(3.0, mass=True), recovers=False),
    ),
}
"""By name: what is promised, and the disturbance."""
