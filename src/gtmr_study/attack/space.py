# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the attacker may choose, and the flight that it makes of that."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gtmr_model import YamlModel
from gtmr_nmpc import Controller, ControllerConfig, Mode
from gtmr_nmpc.closed_loop import l1_sequence
from gtmr_sim import Scenario, World, fly

Array = NDArray[np.float64]

SEGMENTS = 16
"""In how many pieces the attacker sets the gusts of a flight; between them they go in lines."""
OFFSET_M = 0.05
"""How far from the reference a flight may start, sideways and up, and away from the tower [m]."""
ZETA, PHASE, MIX = slice(0, 9), 9, 10
GUSTS = slice(11, 11 + SEGMENTS)
OFFSETS, DELAY = slice(GUSTS.stop, GUSTS.stop + 3), GUSTS.stop + 3
LENGTH = DELAY + 1
"""How many numbers, 0 to 1 each, a choice is."""


class Target(YamlModel):
    """What is attacked."""

    mode: Mode
    """The controller's mode."""
    controller: ControllerConfig
    """The controller."""
    world: World
    """The world."""
    duration_s: float = Field(8.0, gt=0.0, le=600.0)
    """Length of a flight [s]."""


def vertex_choice(vertex: int, worst_case: bool, rng: np.random.Generator) -> Array:
    """Choose a vertex of the box, under gusts at their bound: towards the tower, or L1-worst."""
    u = random_choice(rng)
    u[ZETA] = [(vertex >> j) & 1 for j in range(9)]
    u[PHASE] = 1.0
    u[MIX] = float(worst_case)
    u[GUSTS] = 1.0
    return u


def random_choice(rng: np.random.Generator) -> Array:
    """Choose by chance; zeta at a bound in half of its channels, the gusts mostly L1-worst."""
    u = rng.uniform(size=LENGTH)
    at_bound = rng.uniform(size=9) < 0.5
    u[ZETA] = np.where(at_bound, np.round(u[ZETA]), u[ZETA])
    u[MIX] *= 0.3
    return u


def scenario_of(target: Target, u: Array, seed: int) -> Scenario:
    """Make the scenario of a choice, shape (31,); its noise goes by the seed."""
    config, world = target.controller, target.world
    box = config.uncertainty
    zeta = (2.0 * u[ZETA] - 1.0) * box.half_widths
    odometry = world.odometry
    # Nothing later than is stated, nor earlier than its jitter.
    jitter_s = float(u[DELAY]) * odometry.jitter_s
    odometry = odometry.model_copy(update={"jitter_s": jitter_s})
    away, aside, up = OFFSET_M * np.array([u[OFFSETS][0], *(2.0 * u[OFFSETS][1:] - 1.0)])
    start = config.helix.at(0.0, config.tower).position[0]
    c, s = start[:2] / math.hypot(*start[:2])
    return Scenario(
        vehicle=config.vehicle,
        tower=config.tower,
        helix=config.helix,
        uncertainty=box,
        zeta=tuple(zeta.tolist()),
        gust={"kind": "l1", "sequence": _gusts(target, u)},
        world=world.model_copy(update={"odometry": odometry}),
        start_offset_m=(c * away - s * aside, s * away + c * aside, up),
        guard="hold",
        seed=seed,
    )


def fly_choices(target: Target, choices: list[Array], seeds: list[int]) -> list[float]:
    """Least d_T of any plant step of each choice's flight [m].

    Raises ValueError if a flight diverges.
    """
    controller, least_m = Controller(target.controller, target.mode), []
    for u, seed in zip(choices, seeds, strict=True):
        controller.reset()
        log = fly(scenario_of(target, u, seed), controller, target.duration_s)
        if not math.isfinite(log.least_clearance_m):
            raise ValueError("a flight diverged: its clearance is not finite")
        least_m.append(log.least_clearance_m)
    return least_m


@lru_cache(maxsize=4)
def _worst(config: ControllerConfig, mode: Mode) -> Array:
    return np.array(l1_sequence(config, mode))


def _gusts(target: Target, u: Array) -> tuple[float, ...]:
    """L1-worst up to some moment, mixed with lines between the segments' values."""
    steps = round(target.duration_s / target.controller.sampling_time_s)
    worst = _worst(target.controller, target.mode)
    # The moment by which the worst has been done: from a fifth of the flight on.
    end = round((0.2 + 0.8 * float(u[PHASE])) * steps)
    told = np.full(steps, worst[-1])
    told[:end] = np.resize(worst[::-1], end)[::-1]
    at = np.linspace(0.0, steps - 1.0, SEGMENTS)
    own = np.interp(np.arange(steps), at, 2.0 * u[GUSTS] - 1.0)
    mix = float(u[MIX])
    return tuple(np.clip((1.0 - mix) * told + mix * own, -1.0, 1.0).tolist())
