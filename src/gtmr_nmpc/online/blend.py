# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The share of each mode that is in force: a switch takes a while, so that it makes no bump."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gtmr_nmpc.config import MODES, Mode, Weights


@dataclass(frozen=True)
class Blend:
    """How far two modes have come in, 0 to 1 each; what is left is the nominal one."""

    robust: float
    """Of eq. (15)."""
    offset_free: float
    """Of the mode ``offset_free``."""

    @classmethod
    def of(cls, mode: Mode) -> Blend:
        """Make a mode wholly in force."""
        return cls(float(mode == "robust"), float(mode == "offset_free"))

    def towards(self, mode: Mode, most: float) -> Blend:
        """Go on to a mode, each share by ``most`` at most."""
        due = WHOLLY[mode]
        if self == due:
            return due
        return Blend(
            self.robust + min(max(due.robust - self.robust, -most), most),
            self.offset_free + min(max(due.offset_free - self.offset_free, -most), most),
        )

    @property
    def margin_scale(self) -> float:
        """How much of the margins of eq. (15) applies."""
        return _gently(self.robust)

    @property
    def offset_free_scale(self) -> float:
        """How much of the estimates, weights and margins of ``offset_free`` applies."""
        return _gently(self.offset_free)


WHOLLY = {mode: Blend.of(mode) for mode in MODES}
"""Every mode wholly in force."""


def _gently(progress: float) -> float:
    """Begin and end gently: a margin that grows at once at full rate is a jerk of its own."""
    return progress * progress * (3.0 - 2.0 * progress)


def between(a: Weights, b: Weights, share: float) -> Weights:
    """Weights on the way from a to b, by the same ratio for every equal part of the way."""

    def mixed(one: float, other: float) -> float:
        if one <= 0.0 or other <= 0.0:
            return (1.0 - share) * one + share * other
        return float(one ** (1.0 - share) * other**share)

    values: dict[str, Any] = {}
    for name in Weights.model_fields:
        one, other = getattr(a, name), getattr(b, name)
        if isinstance(one, tuple):
            values[name] = tuple(mixed(*pair) for pair in zip(one, other, strict=True))
        else:
            values[name] = mixed(one, other)
    return Weights(**values)
