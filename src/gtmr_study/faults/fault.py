# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a fault is: a promise, and a way to try it any number of times."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

Rng = np.random.Generator


@dataclass(frozen=True)
class Outcome:
    """What one try showed."""

    held: bool
    """Whether the promise was kept."""
    clearance_m: float | None = None
    """The least clearance of the whole flight [m]; None where nothing was flown."""
    recovery_s: float | None = None
    """From the end of the fault until all was as before [s]; None if it was not, or need not."""
    why: str = ""
    """What was not kept, in a few words."""


@dataclass(frozen=True)
class Fault:
    """A fault that can be tried; the same number of a try is the same try on any machine."""

    name: str
    """What the command line and the tables call it."""
    promise: str
    """What holds under it, in one sentence."""
    place: Literal["loop", "bytes", "files", "nodes"]
    """Where it is put in: the closed loop in process, messages as bytes, files, real nodes."""
    tries: int
    """How often the whole campaign tries it."""
    quick: int
    """How often the quick one does."""
    run: Callable[[Sequence[Rng]], Iterable[Outcome]]
    """Tries it once for each source of random numbers."""
    always: bool = True
    """Whether the promise is to hold in every try; else it is only counted."""

    def outcomes(self, tries: Sequence[int]) -> Iterator[Outcome]:
        """Try it, by the numbers of the tries."""
        stream = zlib.crc32(self.name.encode())
        yield from self.run([np.random.default_rng([stream, k]) for k in tries])


@dataclass(frozen=True)
class OneByOne:
    """Makes a ``run`` of a function of one source of random numbers."""

    once: Callable[[Rng], Outcome]

    def __call__(self, rngs: Sequence[Rng]) -> Iterator[Outcome]:
        """Try once for each."""
        return map(self.once, rngs)
