# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How rivals are tuned: a seeded search over each one's own few numbers, on flights of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Generic, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field

from gtmr_model import Helix, YamlModel
from gtmr_model.yaml_model import presets_of
from gtmr_nmpc import ControllerConfig
from gtmr_sim import Scenario, StepController, World, fly
from gtmr_study.campaign.study import Study, controller_for

Array = NDArray[np.float64]

SEED = 150_000_007
"""Of the trials of a search and of its choices: far from those of campaigns, which begin at 0, so
that no trial is both tuned on and scored."""
WORLDS = ("paper", "field", "hard")
"""Worlds that rivals are tuned for, each by itself."""
TRIALS = 6
"""Flights of a set of numbers, at each distance: every other one at a vertex of the uncertainty
set, so that no numbers are chosen that only just hold."""
EVALUATIONS = 25
"""Sets of numbers that a search tries."""
DURATION_S = 10.0
"""Length of a flight [s]."""
SETTLED_S = 5.0
"""When the start of a flight is over [s]."""
OFFSET_M = 0.30
"""d_ref, at which every rival is tuned [m]."""
TIGHT_OFFSET_M = 0.22
"""d_ref, at which one with a constraint is tuned as well: its margin must pay off there [m]."""
SHORTFALL_FACTOR = 10.0
"""What a metre below d_min costs, where a metre of tracking error costs 1."""
EFFORT_S_M_PER_HZ = 5e-5
"""What an RMS of rotor accelerations of 1 Hz/s costs, so that no search buys a tenth of a
millimetre with rotors that rattle: 5 mm at 100 Hz/s."""
FAILED_M = 10.0
"""Cost of a flight that failed [m]."""
SIGMA, POPULATION = 0.25, 8
"""With which CMA-ES begins, of a number's range on the logarithmic scale, and its population."""


class RivalParameters(YamlModel):
    """The numbers that a rival is tuned by: 2 to 6 fields, one float each.

    A field's bounds, ``ge`` above 0 and ``le``, are the range that is searched, on a logarithmic
    scale, and its default is where a search begins.
    """

    @classmethod
    def logarithmic_ranges(cls) -> Array:
        """Natural logarithms of the fields' bounds, shape (n, 2)."""
        bounds = [
            [
                getattr(told, name)
                for name in ("ge", "le")
                for told in info.metadata
                if hasattr(told, name)
            ]
            for info in cls.model_fields.values()
        ]
        return np.log(bounds)

    def in_ranges(self) -> Array:
        """Where they lie in their ranges, 0 to 1 each, shape (n,)."""
        low, high = self.logarithmic_ranges().T
        return np.asarray((np.log(list(self.model_dump().values())) - low) / (high - low))


P = TypeVar("P", bound=RivalParameters)


class Found(YamlModel):
    """What a search found for one world."""

    cost_m: float
    """Cost of the numbers, see `cost` [m]."""
    flights: int
    """How many were flown to find them."""
    parameters: dict[str, float]
    """The numbers, by the names and in the units of the rival's `RivalParameters`."""


class Tuning(YamlModel):
    """What the searches for one rival found: a file ``config/rivals/NAME.yaml``."""

    seed: int = Field(ge=0)
    """Seed of the trials and of the search."""
    worlds: dict[str, Found]
    """By the world's name."""


@dataclass(frozen=True)
class Tuned(Generic[P]):
    """A rival that is tuned; called, it makes the controller of one flight."""

    name: str
    """Of the rival, and of its file under ``config/rivals``."""
    parameters: type[P]
    """Its numbers."""
    build: Callable[[ControllerConfig, P], StepController]
    """Makes a controller for one flight, from the problem and the numbers."""
    constrained: bool = False
    """Whether it keeps a constraint on the clearance; then it is tuned close to it as well."""

    def __call__(self, config: ControllerConfig, scenario: Scenario) -> StepController:
        """Make the controller with the numbers found for the scenario's world.

        A world of one's own has those of the world whose controller flies in it, a rival that was
        not tuned its defaults. ConfigError if its file does not fit it.
        """
        return self.build(config, self.found(scenario.world))

    def found(self, world: World) -> P:
        """Give the numbers that a search found for a world."""
        preset = controller_for(world)
        name = "paper" if preset == "default" else preset
        worlds = _tuning(self.name).worlds
        numbers = worlds[name].parameters if name in worlds else {}
        return self.parameters.parse(numbers, f"config/rivals/{self.name}.yaml, {name}")


@lru_cache(maxsize=32)
def _tuning(name: str) -> Tuning:
    if name not in presets_of("rivals"):
        return Tuning(seed=SEED, worlds={})
    return Tuning.preset("rivals", name)


def cost(
    build: Callable[[ControllerConfig], StepController],
    world: str,
    trials: int = TRIALS,
    constrained: bool = False,
) -> float:
    """Fly trials in a world and say what they cost [m]; less is better.

    The mean over the trials of the largest deviation inward from d_ref and the RMS of the radial
    deviation, both after the first 5 s, at d_ref = 0.30 m. For a rival with a constraint this is
    added up with d_ref = 0.22 m, without the deviation inward. Ten times the largest shortfall
    below d_min at any time comes on top, and 5 mm for rotor accelerations of 100 Hz/s RMS. A
    flight that fails costs 10 m.

    Parameters
    ----------
    build : callable
        Makes the controller of one flight from its problem.
    world : str
        Name of the world's preset.
    trials : int
        Flights at each distance, the same for everybody.
    constrained : bool
        Whether the rival keeps a constraint on the clearance.
    """
    offsets_m = (OFFSET_M, TIGHT_OFFSET_M) if constrained else (OFFSET_M,)
    costs = [[_flight_cost(build, world, m, k) for k in range(trials)] for m in offsets_m]
    return float(np.mean(costs, axis=1).sum())


def _flight_cost(
    build: Callable[[ControllerConfig], StepController], world: str, offset_m: float, trial: int
) -> float:
    study = _study(world, offset_m)
    scenario = study.scenario(trial)
    if trial % 2:
        vertices = study.true_uncertainty.vertices()
        vertex = vertices[np.random.default_rng([SEED, trial]).integers(len(vertices))]
        scenario = scenario.model_copy(update={"zeta": tuple(vertex.tolist())})
    try:
        log = fly(scenario, build(study.controller), DURATION_S, study.controller.sampling_time_s)
    except Exception:
        # Whatever a set of numbers makes of a controller, the search must go on.
        return FAILED_M
    d_T = log.d_T[log.t >= SETTLED_S]
    if not np.isfinite(d_T).all() or d_T.min() < 0.0:
        return FAILED_M
    off_m = d_T - offset_m
    shortfall_m = max(0.0, scenario.tower.min_clearance_m - log.least_clearance_m)
    spent_m = SHORTFALL_FACTOR * shortfall_m + _rms(off_m) + EFFORT_S_M_PER_HZ * _rms(log.u)
    if offset_m == OFFSET_M:
        spent_m += max(0.0, -float(off_m.min()))
    return min(FAILED_M, spent_m)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@lru_cache(maxsize=8)
def _study(world: str, offset_m: float) -> Study:
    named = World.preset("world", world)
    config = ControllerConfig.preset("controller", controller_for(named))
    config = config.model_copy(update={"helix": Helix(offset_m=offset_m)})
    return Study(world=named, controller=config, seed=SEED, duration_s=DURATION_S)


def search(
    rival: Tuned[P],
    world: str,
    evaluations: int = EVALUATIONS,
    trials: int = TRIALS,
    on_progress: Callable[[int, float], None] | None = None,
) -> Found:
    """Search the numbers of a rival for one world with CMA-ES, from its defaults on.

    Parameters
    ----------
    rival : Tuned
        Who is tuned.
    world : str
        Name of the world's preset.
    evaluations : int
        Sets of numbers to try, the defaults the first of them.
    trials : int
        Flights of a set at each distance.
    on_progress : callable, optional
        Told how many sets were tried, and the least cost so far [m].
    """
    # Only here: of all that fly rivals only a search needs it.
    import cmaes

    low, high = rival.parameters.logarithmic_ranges().T
    begin = rival.parameters().in_ranges()
    choose = cmaes.CMA(
        mean=begin,
        sigma=SIGMA,
        bounds=np.tile([0.0, 1.0], (len(begin), 1)),
        seed=SEED % 2**32,
        population_size=POPULATION,
    )

    def evaluate(position: Array) -> tuple[float, dict[str, float]]:
        values = np.exp(low + position * (high - low))
        # Three digits are what such a search can tell apart.
        rounded = [float(f"{value:.3g}") for value in values]
        numbers = dict(zip(rival.parameters.model_fields, rounded, strict=True))
        made = rival.parameters.model_validate(numbers)
        spent_m = cost(lambda c: rival.build(c, made), world, trials, rival.constrained)
        return spent_m, numbers

    best = evaluate(begin)
    tried = 1
    while tried < evaluations and not choose.should_stop():
        generation = [choose.ask() for _ in range(choose.population_size)]
        results = [evaluate(position) for position in generation]
        best = min(best, *results, key=lambda result: result[0])
        choose.tell([(p, c) for p, (c, _) in zip(generation, results, strict=True)])
        tried += len(generation)
        if on_progress is not None:
            on_progress(tried, best[0])
    flights = tried * trials * (2 if rival.constrained else 1)
    return Found(cost_m=round(best[0], 5), flights=flights, parameters=best[1])


def as_yaml(rival: Tuned[P], tuning: Tuning) -> str:
    """Write the file of a rival, with what its numbers mean."""
    meanings = [
        f"#   {name}: {' '.join((info.description or '').split())}"
        for name, info in rival.parameters.model_fields.items()
    ]
    said = [
        f"# Numbers of a rival, found by python bench/tune_rivals.py {rival.name}:",
        *meanings,
    ]
    return "\n".join(said) + "\n" + yaml.safe_dump(tuning.model_dump(), sort_keys=False)
