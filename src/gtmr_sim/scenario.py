# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a simulated flight is made of: the world, the true parameters, the gusts, the seed."""

from __future__ import annotations

import inspect
import math
from typing import Annotated, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, SerializeAsAny, model_validator
from typing_extensions import Self

from gtmr_model import (
    ConfigError,
    Helix,
    NamedVehicle,
    ReferencePath,
    Tower,
    UncertaintySet,
    Vehicle,
    YamlModel,
)
from gtmr_sim.registry import EFFECTS, GUSTS
from gtmr_sim.worlds.world import PAPER, NamedWorld

GUST_KINDS = ("ou", "dryden", "sinusoid", "worst-case", "l1", "none")
"""Clipped Ornstein-Uhlenbeck, clipped Dryden, sinusoid, constant towards the tower, a sequence of
shares of the bound towards the tower, none: those that come with the suite."""


Purpose = Literal["zeta", "gust", "odometry", "wind", "guard"]
"""Purposes for which random numbers are drawn."""


def _effects(names: tuple[str, ...]) -> tuple[str, ...]:
    # ROS 2 knows no empty list of texts: an empty text stands for it.
    return tuple(EFFECTS.require(name) for name in names if name)


EffectNames = Annotated[tuple[str, ...], AfterValidator(_effects)]
"""Names of vehicle effects in a configuration."""


def whole_steps(name: str, time_s: float, part: str, part_s: float) -> int:
    """How many times a part fits into a time [s]; ConfigError if it is no whole number."""
    ratio = time_s / part_s
    if not (ratio < math.inf and round(ratio) >= 1 and abs(ratio - round(ratio)) < 1e-6):
        raise ConfigError(
            f"{name} = {time_s:g} s: allowed is a whole number of times {part}, {part_s:g} s"
        )
    return round(ratio)


Share = Annotated[float, Field(ge=-1.0, le=1.0)]


class GustConfig(YamlModel):
    """The gust force; its norm never exceeds the bound of the uncertainty set."""

    kind: Annotated[str, AfterValidator(GUSTS.require), GUSTS] = "ou"
    """Which model: one that comes with the suite, or a registered or installed one."""
    std_n: float = Field(0.25, ge=0.0)
    """Standard deviation per axis before clipping, of ``ou`` and ``dryden`` [N]; assumed."""
    correlation_time_s: float = Field(0.5, gt=0.0)
    """Correlation time of ``ou`` [s]; assumed."""
    period_s: float = Field(2.0, gt=0.0)
    """Period of ``sinusoid`` [s]; assumed."""
    airspeed_m_s: float = Field(8.0, gt=0.0)
    """Mean wind speed that carries the ``dryden`` turbulence past the vehicle [m/s]; assumed."""
    sequence: Annotated[tuple[Share, ...], Field(min_length=1)] = (0.0,)
    """What ``l1`` plays over and over: shares of the bound, inward, one a hold period [-]. The
    worst one for a controller is the sign of its closed loop's impulse response."""
    parameters: dict[str, float] = Field(default_factory=dict)
    """Numbers of a model of your own, by the names of its function's arguments."""

    @model_validator(mode="after")
    def _takes(self) -> Self:
        if self.model_fields_set:
            try:
                inspect.signature(GUSTS[self.kind]).bind(None, **self.parameters)
            except TypeError as error:
                raise ValueError(f"gust {self.kind!r}, parameters: {error}") from None
        return self

    def require_sequence(self) -> None:
        """Raise ConfigError if `l1` has a sequence of zeros."""
        if self.kind == "l1" and not any(self.sequence):
            raise ConfigError(
                f"gust.sequence = {list(self.sequence)}: gust 'l1' needs shares of the bound, "
                "-1 to 1, not all 0"
            )


class Scenario(YamlModel):
    """The plant's side of a flight; the controller knows nothing of ``zeta`` and the gusts."""

    vehicle: NamedVehicle = Field(default_factory=Vehicle.paper)
    """Nominal parameters, from which ``zeta`` deviates."""
    tower: Tower = Tower()
    """The tower."""
    helix: SerializeAsAny[ReferencePath] = Helix()
    """Where the flight starts: on the reference, at its velocity."""
    start_offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From there, world frame [m]."""
    uncertainty: UncertaintySet = UncertaintySet()
    """Bounds on ``zeta`` and on the gusts."""
    zeta: Annotated[tuple[float, ...], Field(min_length=9, max_length=9)] = (0.0,) * 9
    """The true mismatch [-] and wind bias [N, world frame], eq. (4)."""
    gust: GustConfig = GustConfig()
    """The gusts."""
    world: NamedWorld = PAPER
    """What the vehicle meets beyond eq. (3): a preset's name, a YAML file, or the effects."""
    effects: EffectNames = ()
    """Forces and torques on the true vehicle beyond eq. (3), by their registered names."""
    guard: Literal["retreat", "hold"] = "retreat"
    """What the rotors do past a plan's end: the guard brakes, retreats from the tower and hovers,
    or, as in the paper's study, which has no guard, they hold their speeds."""
    seed: int = Field(0, ge=0)
    """Seed of the gusts, and of zeta where it is sampled."""
    step_s: float = Field(1e-3, gt=0.0, le=0.01)
    """The plant's integration step [s]."""
    gust_hold_s: float = Field(0.025, gt=0.0)
    """How long a gust sample is held [s]; a whole number of times ``step_s``."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self.uncertainty.require_inside(self.zeta)
        self.gust.require_sequence()
        whole_steps("gust_hold_s", self.gust_hold_s, "step_s", self.step_s)
        return self

    def sampled(self) -> Scenario:
        """Return this scenario with zeta drawn from the uncertainty set by its seed."""
        zeta = self.uncertainty.sample(self.rng("zeta"))
        return self.model_copy(update={"zeta": tuple(zeta.tolist())})

    def rng(self, purpose: Purpose) -> np.random.Generator:
        """Random numbers of this seed for one purpose, independent of the other purposes."""
        return np.random.default_rng([self.seed, get_args(Purpose).index(purpose)])

    @property
    def zeta_array(self) -> NDArray[np.float64]:
        """The true zeta, shape (9,)."""
        return np.array(self.zeta)
