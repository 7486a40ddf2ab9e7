# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Plans of a campaign: which true mismatches zeta its trials fly with."""

import itertools
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator
from typing_extensions import Self

from gtmr_model import CHANNELS, N_ZETA, UncertaintySet, YamlModel

Array = NDArray[np.float64]
PlanKind = Literal["random", "vertices", "one-at-a-time", "grid"]
PLAN_KINDS: tuple[PlanKind, ...] = ("random", "vertices", "one-at-a-time", "grid")
"""Uniform in the box, its 512 vertices, one channel after the other, two channels together."""


class TrialPlan(YamlModel):
    """Which points of the uncertainty box the trials visit."""

    kind: PlanKind = "random"
    """``random`` draws every trial anew; the others have a fixed list of points."""
    channels: tuple[str, ...] = ()
    """Channels to vary: two for ``grid``, any for ``one-at-a-time`` (left out: all); none for the
    others."""
    levels: int = Field(5, ge=2, le=101)
    """How many values a varied channel takes, from one bound to the other."""

    @field_validator("channels")
    @classmethod
    def _known(cls, channels: tuple[str, ...]) -> tuple[str, ...]:
        for name in channels:
            if name not in CHANNELS:
                raise ValueError(f"there is no channel {name!r}: there is {', '.join(CHANNELS)}")
        if len(set(channels)) < len(channels):
            raise ValueError("a channel is named twice")
        return channels

    @model_validator(mode="after")
    def _as_many_as_needed(self) -> Self:
        if self.channels and self.kind in ("random", "vertices"):
            raise ValueError(f"the plan {self.kind!r} varies all channels; leave channels out")
        if self.kind == "grid" and len(self.channels) != 2:
            raise ValueError(
                f"a grid needs 2 channels, not {len(self.channels)}: name two of "
                f"{', '.join(CHANNELS)}"
            )
        return self

    def points(self, uncertainty: UncertaintySet, seed: int) -> Array | None:
        """List the plan's values of zeta, shape (n, 9); trial k flies point k modulo n.

        None for ``random``, where the trial's own seed draws them. The seed shuffles the vertices,
        so that fewer trials than vertices are a fair choice of them.
        """
        match self.kind:
            case "random":
                return None
            case "vertices":
                return np.random.default_rng(seed).permutation(uncertainty.vertices())
            case "one-at-a-time":
                return _one_at_a_time(self.channels or CHANNELS, self.levels, uncertainty)
            case "grid":
                return _grid(self.channels, self.levels, uncertainty)


def _one_at_a_time(channels: tuple[str, ...], levels: int, uncertainty: UncertaintySet) -> Array:
    """Make the nominal point once, then every channel's other levels."""
    points = [np.zeros(N_ZETA)]
    for name in channels:
        j = CHANNELS.index(name)
        for level in np.linspace(-1.0, 1.0, levels):
            if level != 0.0:
                points.append(np.zeros(N_ZETA))
                points[-1][j] = level * uncertainty.half_widths[j]
    return np.array(points)


def _grid(channels: tuple[str, ...], levels: int, uncertainty: UncertaintySet) -> Array:
    axis = np.linspace(-1.0, 1.0, levels)
    indices = [CHANNELS.index(name) for name in channels]
    points = np.zeros((levels ** len(indices), N_ZETA))
    points[:, indices] = list(itertools.product(axis, repeat=len(indices)))
    return points * uncertainty.half_widths
