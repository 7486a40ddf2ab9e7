# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a margin is: given the iterate, it returns by how much to tighten every stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_model import N_ZETA, OneOfKinds

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tightening:
    """By how much the clearance constraint is tightened at stages 0..N [m], eq. (14)."""

    by_channel: Array
    """What of alpha_p each channel of zeta brings, shape (N + 1, 9)."""
    eps_s: Array
    """What of alpha_p no channel brings: eps_s of eq. (12), shape (N + 1,)."""
    gust: Array
    """For gusts, shape (N + 1,)."""
    noise: Array = field(default_factory=lambda: np.zeros(()))
    """For noise of the measurements, shape (N + 1,); none if left out, as in the paper."""

    def __post_init__(self) -> None:
        """Give noise that was left out its shape."""
        if not self.noise.shape:
            object.__setattr__(self, "noise", np.full(self.gust.shape, self.noise))

    @classmethod
    def constant(cls, eps_s: ArrayLike) -> Tightening:
        """Tighten by what belongs to no cause, shape (N + 1,) [m]."""
        eps = np.asarray(eps_s, dtype=float)
        return cls(np.zeros((len(eps), N_ZETA)), eps, np.zeros(len(eps)))

    @cached_property
    def parametric(self) -> Array:
        """alpha_p, shape (N + 1,)."""
        return np.asarray(self.by_channel.sum(axis=1) + self.eps_s)

    @cached_property
    def random(self) -> Array:
        """alpha_g, for gusts and noise, shape (N + 1,)."""
        return np.asarray(self.gust + self.noise)

    @cached_property
    def total(self) -> Array:
        """alpha_p + alpha_g, shape (N + 1,)."""
        return self.parametric + self.random

    def scaled(self, by: float) -> Tightening:
        """Let only a part of it count, 0 to 1."""
        return Tightening(by * self.by_channel, by * self.eps_s, by * self.gust, by * self.noise)

    def plus(self, other: Tightening) -> Tightening:
        """Keep away by the sum of both."""
        return Tightening(
            self.by_channel + other.by_channel,
            self.eps_s + other.eps_s,
            self.gust + other.gust,
            self.noise + other.noise,
        )


@dataclass(frozen=True)
class Iterate:
    """The plan along which the next one is linearised: what a margin may depend on."""

    config: Any
    """The problem, a `ControllerConfig`."""
    x: Array
    """States, shape (N + 1, 12 + N_p)."""
    u: Array
    """Rotor accelerations [Hz/s], shape (N, N_p)."""
    sensitivities: Callable[[], Array]
    """Computes Pi."""
    deviations: Callable[[], Any] = dict
    """Computes what the closed loop may deviate by, `Deviations`; in the mode ``offset_free``."""
    observed_steps: int = 0
    """How many steps ago disturbances began to be estimated."""

    @cached_property
    def Pi(self) -> Array:
        """Sensitivities dx/dzeta of eq. (8), shape (N + 1, 12 + N_p, 9); computed when asked."""
        return self.sensitivities()


class Margin(OneOfKinds):
    """A margin; a subclass with a ``kind`` of its own can be chosen by that name."""

    kind: str = "paper"
    """Which margin."""

    def tightening(self, iterate: Iterate) -> Tightening | ArrayLike:
        """Return by how much to tighten: the sum, shape (N + 1,) [m], or its parts."""
        raise NotImplementedError


def tightening_of(margin: Margin, iterate: Iterate) -> Tightening:
    """Evaluate a margin; ValueError if the result is not a tightening of N + 1 stages."""
    stages, given = len(iterate.x), margin.tightening(iterate)
    if not isinstance(given, Tightening):
        given = Tightening.constant(np.atleast_1d(given))
    shapes = [part.shape for part in (given.eps_s, given.gust, given.noise)]
    fits = given.by_channel.shape == (stages, N_ZETA) and shapes == [(stages,)] * 3
    if not fits or not np.isfinite(given.total).all():
        raise ValueError(
            f"{type(margin).__name__} gave a tightening that is not {stages} finite numbers [m]"
        )
    return given
