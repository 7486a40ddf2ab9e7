# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is flown in an arena: who, in which worlds, how close to the tower, how often."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from pydantic import Field, field_validator, model_validator
from typing_extensions import Self

from gtmr_model import YamlModel
from gtmr_sim import World
from gtmr_sim.worlds.world import NamedWorld
from gtmr_study.campaign.study import Study, at_distance
from gtmr_study.own_controller import ControllerFingerprint, OwnController
from gtmr_study.result_files import InputError
from gtmr_study.rivals.catalogue import RIVALS

WORLDS = ("paper", "field", "hard")
"""Worlds that are flown in unless others are named."""
DISTANCES_M = (0.21, 0.25, 0.30, 0.35, 0.40)
"""Distances of the reference from the tower's surface, likewise [m]."""


class Cell(NamedTuple):
    """A controller in a world, with the reference at a distance: a point of the figure."""

    controller: str
    """Its name, or the class of one's own."""
    world: str
    """Its name."""
    d_ref_m: float
    """d_ref [m]."""


class MetWorld(YamlModel):
    """A world and what rows call it."""

    name: str
    """That of the preset, or of the file without its ending."""
    world: NamedWorld
    """What the vehicle meets."""

    @classmethod
    def named(cls, name_or_path: str) -> MetWorld:
        """Load a preset by its name, or a YAML file by its path."""
        world = World.load("world", name_or_path)
        return cls(name=Path(name_or_path).stem, world=world)


class Arena(YamlModel):
    """The plan of an arena; the same plan is the same flights wherever it runs.

    Trial k has the same zeta, gusts and noise for every controller and at every distance, and the
    same zeta and seeds in every world.
    """

    controllers: tuple[str, ...] = Field(min_length=1)
    """Names in `RIVALS`, or of classes in ``own``."""
    own: tuple[ControllerFingerprint, ...] = ()
    """Controllers of one's own; this only says what they are."""
    worlds: tuple[MetWorld, ...] = Field(min_length=1)
    """Where they fly."""
    d_ref_m: tuple[float, ...] = Field(DISTANCES_M, min_length=1)
    """Distances of the reference from the tower's surface [m]."""
    trials: int = Field(200, ge=1, le=100_000)
    """Flights of a cell; of controllers whose step takes long it is their share of it."""
    seed: int = Field(0, ge=0)
    """With the number of a trial it gives the trial's own seed, as in a campaign."""
    duration_s: float = Field(20.0, ge=0.025, le=3600.0)
    """Length of a flight [s]."""
    step_budget_ms: float = Field(500.0, gt=0.0)
    """What the steps of a flight may take on average [ms]; beyond that it is stopped."""
    patience_s: float = Field(5.0, gt=0.0)
    """What a flight may take at least after its first step, whatever its steps take [s]."""

    @field_validator("d_ref_m")
    @classmethod
    def _in_order(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(sorted(set(values)))

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        own = [each.name for each in self.own]
        names = [each.name for each in self.worlds]
        for what, given in (("controller", self.controllers), ("world", names)):
            for name in given:
                if given.count(name) > 1:
                    raise ValueError(f"{what} {name!r} is named twice")
        for name in self.controllers:
            if name not in RIVALS and name not in own:
                raise ValueError(f"controller {name!r}: there is {', '.join(RIVALS)}")
        return self

    def cells(self) -> list[Cell]:
        """Every point of the figure, a controller after the other."""
        return [
            Cell(controller, met.name, d_ref_m)
            for controller in self.controllers
            for met in self.worlds
            for d_ref_m in self.d_ref_m
        ]

    def trials_of(self, controller: str) -> int:
        """How many flights of a cell a controller flies."""
        share = RIVALS[controller].trials if controller in RIVALS else 1.0
        return max(1, round(share * self.trials))

    def family_of(self, controller: str) -> str:
        """Say in one line what a controller is."""
        return RIVALS[controller].family if controller in RIVALS else "a controller of one's own"

    def study(self, world: str, d_ref_m: float) -> Study:
        """Make the campaign whose scenarios are those of a world and a distance [m].

        Its controller is the preset that is told of the world. ConfigError if there can be no
        reference there.
        """
        return _study(self, world, d_ref_m)


@lru_cache(maxsize=64)
def _study(arena: Arena, world: str, d_ref_m: float) -> Study:
    met = next(each.world for each in arena.worlds if each.name == world)
    study = Study(world=met, trials=arena.trials, seed=arena.seed, duration_s=arena.duration_s)
    return study.model_copy(update={"controller": at_distance(study.controller, d_ref_m)})


def named_controllers(option: str, value: str | None) -> tuple[list[str], list[OwnController]]:
    """Read names and ``file.py:Class``, apart by commas; all of the arena's if nothing is given.

    They come in the order of the arena, then one's own, so that the order in which they are given
    does not matter. InputError if there is no such controller or file, or one is named twice.
    """
    given = list(RIVALS) if value is None else value.split(",")
    found = [(name, OwnController.named(option, name)) for name in given]
    own = [each for _, each in found if each is not None]
    names = [name for name, each in found if each is None]
    for name in names:
        if name not in RIVALS:
            raise InputError(
                f"{option} = {name!r}: allowed is {', '.join(RIVALS)}, or file.py:Class"
            )
    labels = [*names, *(each.name for each in own)]
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(f"{option} = {value}: {label} is named twice")
    for each in own:
        if each.name in RIVALS:
            raise InputError(
                f"{option} = {each.path}:{each.name}: the arena has a {each.name} already; give "
                "the class another name"
            )
    return sorted(names, key=list(RIVALS).index), sorted(own, key=lambda each: each.name)
