# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A study in one file: who flies, against which uncertainty, how often, by which plan."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator
from typing_extensions import Self

from gtmr_model import ConfigError, Helix, UncertaintySet, YamlModel
from gtmr_model.yaml_model import named, presets_of
from gtmr_nmpc import MODES, PAPER_MODES, ControllerConfig, Mode
from gtmr_sim import GustConfig, Scenario, World
from gtmr_sim.scenario import EffectNames, whole_steps
from gtmr_sim.worlds.world import PAPER, NamedWorld
from gtmr_study.campaign.plans import TrialPlan
from gtmr_study.own_controller import ControllerFingerprint

RANDOM_TRIALS = 500
"""Trials of a random plan that does not say how many, as in the paper."""


NamedController = Annotated[ControllerConfig, named("controller", ControllerConfig.load)]
"""A controller in a study: its fields, a preset's name, or the path of a YAML file."""


def controller_for(world: World) -> str:
    """Name the preset of a controller that is told of a world: that of its name, or the default.

    A world is known by what it is, however it was named.
    """
    if world == PAPER:
        return "default"
    told = sorted(presets_of("world").keys() & presets_of("controller").keys())
    known = (name for name in told if World.preset("world", name) == world)
    return next(known, "default")


class Study(YamlModel):
    """A Monte-Carlo campaign; the same study is the same flights wherever it runs."""

    world: NamedWorld = PAPER
    """What the vehicle meets beyond eq. (3): a preset's name, a YAML file, or the effects."""
    controller: NamedController = Field(
        default_factory=lambda data: ControllerConfig.load(
            "controller", controller_for(data.get("world", PAPER))
        )
    )
    """The controller, with the vehicle, tower and helix that it believes in; left out: the one
    that is told of the world."""
    modes: tuple[Mode, ...] = Field(PAPER_MODES, min_length=1)
    """Which modes fly every trial."""
    own_controller: ControllerFingerprint | None = None
    """What flies instead, in one mode that is called like it. This only says what it is: its file
    is named on the command line."""
    trials: int | None = Field(None, ge=1, le=10_000_000)
    """How many; left out: 500 if the plan is random, else every point of the plan once."""
    seed: int = Field(0, ge=0)
    """Seed of the campaign; with the number of a trial it gives the trial's own seed."""
    duration_s: float = Field(50.0, ge=0.025, le=86400.0)
    """Length of a flight [s] (Table I)."""
    plan: TrialPlan = TrialPlan()
    """Which true mismatches are flown."""
    gust: GustConfig = GustConfig()
    """The gusts; their bound is that of ``uncertainty``. ``l1`` without a ``sequence`` plays the
    worst one for the mode that flies."""
    effects: EffectNames = ()
    """Forces and torques on the true vehicle beyond eq. (3), by their registered names."""
    uncertainty: UncertaintySet | None = None
    """The box that the true mismatches come from; left out: the one the controller guards
    against."""

    @field_validator("modes")
    @classmethod
    def _each_once(cls, modes: tuple[Mode, ...]) -> tuple[Mode, ...]:
        if len(set(modes)) < len(modes):
            raise ValueError("a mode is named twice")
        # One order for all, so that the order on the command line does not matter.
        return tuple(mode for mode in MODES if mode in modes)

    @model_validator(mode="after")
    def _whole_steps(self) -> Self:
        period_s = self.controller.sampling_time_s
        whole_steps("sampling_time_s", period_s, "the plant's step_s", Scenario().step_s)
        whole_steps("duration_s", self.duration_s, "sampling_time_s", period_s)
        return self

    @property
    def true_uncertainty(self) -> UncertaintySet:
        """The box that the true mismatches come from."""
        return self.uncertainty if self.uncertainty is not None else self.controller.uncertainty

    @property
    def n_trials(self) -> int:
        """How many trials the study has."""
        if self.trials is not None:
            return self.trials
        points = _points(self.plan, self.true_uncertainty, self.seed)
        return RANDOM_TRIALS if points is None else len(points)

    @property
    def flown_modes(self) -> tuple[str, ...]:
        """What the rows of results call who flew: the modes, or an own controller's class."""
        return self.modes if self.own_controller is None else (self.own_controller.name,)

    def flights(self) -> list[tuple[int, str]]:
        """Every trial in every mode: what there is to fly."""
        return [(trial, mode) for trial in range(self.n_trials) for mode in self.flown_modes]

    def against(self, mode: str) -> Study:
        """Return this study with the gusts that a mode shall meet: the worst ones, if it says so.

        ConfigError if these are asked for against a controller of one's own.
        """
        if self.gust.kind != "l1" or any(self.gust.sequence):
            return self
        gust = self.gust.model_copy(update={"sequence": worst_gusts(self.controller, mode)})
        return self.model_copy(update={"gust": gust})

    def scenario(self, trial: int) -> Scenario:
        """Make the world of a trial, with its own seed and true zeta: the same for all modes."""
        controller = self.controller
        scenario = Scenario(
            vehicle=controller.vehicle,
            tower=controller.tower,
            helix=controller.helix,
            uncertainty=self.true_uncertainty,
            gust=self.gust,
            world=self.world,
            effects=self.effects,
            # The paper's study has no guard.
            guard="hold",
            seed=trial_seed(self.seed, trial),
        )
        points = _points(self.plan, self.true_uncertainty, self.seed)
        if points is None:
            return scenario.sampled()
        return scenario.model_copy(update={"zeta": tuple(points[trial % len(points)].tolist())})


def at_distance(config: ControllerConfig, d_ref_m: float | None) -> ControllerConfig:
    """Return a controller whose helix is at a distance from the tower [m]; None changes nothing.

    ConfigError if there can be no such helix, or the controller follows another path.
    """
    if d_ref_m is None:
        return config
    data = Helix.required(config.helix).model_dump() | {"offset_m": d_ref_m}
    return config.model_copy(update={"helix": Helix.parse(data, f"--d-ref = {d_ref_m:g}")})


@lru_cache(maxsize=8)
def worst_gusts(controller: ControllerConfig, mode: str) -> tuple[float, ...]:
    """Compute what gust ``l1`` plays against a mode: shares of the bound, one a hold period [-].

    ConfigError if it is none of the suite's modes.
    """
    if mode not in MODES:
        raise ConfigError(f"gust 'l1' against {mode}: it is known for {', '.join(MODES)}")
    # Only here, as it takes long to import.
    from gtmr_nmpc.closed_loop import l1_sequence

    return l1_sequence(controller, mode)


def mode_order(mode: str) -> int:
    """Place of a mode in tables: that of `MODES`, then own controllers."""
    return (*MODES, mode).index(mode)


def trial_seed(seed: int, trial: int) -> int:
    """Seed of one trial's gusts and sampled mismatch: 32 bits, mixed by NumPy's SeedSequence."""
    return int(np.random.SeedSequence([seed, trial]).generate_state(1)[0])


@lru_cache(maxsize=4)
def _points(plan: TrialPlan, uncertainty: UncertaintySet, seed: int) -> NDArray[np.float64] | None:
    points = plan.points(uncertainty, seed)
    if points is not None:
        # All trials of a process read the same array, perhaps from several threads.
        points.setflags(write=False)
    return points
