# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The guard in C: the sources under ``c/``, compiled for a number of rotors."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from importlib.resources import files

import numpy as np

from gtmr_codegen.library import load_library
from gtmr_guard.config import Array, Parameters

FLAGS = {"gtmr_guard.c": ("-O2", "-ffp-contract=off")}
"""Of the compiler; nothing is fused, so that results are those of other compilers."""


def c_sources(n_rotors: int) -> dict[str, str]:
    """All sources of a guard for N_p rotors, by file name."""
    folder = files("gtmr_guard") / "c"
    names = ("gtmr_guard.c", "gtmr_guard.h")
    written = {name: (folder / name).read_text(encoding="utf-8") for name in names}
    size = f"/* Generated. */\n#define GTMR_GUARD_ROTORS {n_rotors}\n"
    return written | {"gtmr_guard_size.h": size}


class CompiledGuard:
    """A guard's memory and its step in C; CompileError if it cannot be compiled.

    Speaks of itself as `GuardLaw` says.
    """

    def __init__(self, parameters: Parameters) -> None:
        n = len(parameters.inverse)
        self._library = library = _library(n)
        # The library has no memory of its own: these arrays must live as long as the guard.
        self._memory = np.zeros(library.gtmr_guard_size(), np.uint8)
        self._guard = ctypes.c_void_p(self._memory.ctypes.data)
        self._x, self._u_due, self._u = np.zeros(12 + n), np.zeros(n), np.zeros(n)
        x, u_due, u = (a.ctypes.data for a in (self._x, self._u_due, self._u))
        self._position, self._attitude, self._rotors, self._due, self._out = (
            ctypes.c_void_p(address) for address in (x, x + 8 * 3, x + 8 * 12, u_due, u)
        )
        self._step = library.gtmr_guard_step
        self.reconfigure(parameters)
        self.reset()

    @property
    def addresses(self) -> tuple[int, int]:
        """Where ``gtmr_guard_step`` is, and the memory of this guard, for other compiled code."""
        function = ctypes.cast(self._step, ctypes.c_void_p).value
        assert function is not None
        return function, self._memory.ctypes.data

    def reset(self) -> None:
        """See `GuardLaw.reset`."""
        self._library.gtmr_guard_reset(self._guard)

    def reconfigure(self, parameters: Parameters) -> None:
        """See `GuardLaw.reconfigure`."""
        numbers = np.concatenate([np.ravel(value) for value in parameters])
        self._library.gtmr_guard_configure(self._guard, ctypes.c_void_p(numbers.ctypes.data))

    def step(
        self, dt_s: float, x: Array, u_due: Array, overdue_s: float, age_s: float
    ) -> tuple[int, Array]:
        """See `GuardLaw.step`."""
        self._x[:] = x
        self._u_due[:] = u_due
        cause = self._step(
            self._guard,
            dt_s,
            self._position,
            self._attitude,
            self._rotors,
            self._due,
            overdue_s,
            age_s,
            self._out,
        )
        return cause, self._u.copy()


@lru_cache(maxsize=16)
def _library(n_rotors: int) -> ctypes.CDLL:
    library = load_library("the guard", c_sources(n_rotors), FLAGS)
    pointer, number = ctypes.c_void_p, ctypes.c_double
    library.gtmr_guard_size.restype = ctypes.c_size_t
    library.gtmr_guard_configure.restype = library.gtmr_guard_reset.restype = None
    library.gtmr_guard_configure.argtypes = [pointer, pointer]
    library.gtmr_guard_reset.argtypes = [pointer]
    library.gtmr_guard_step.restype = ctypes.c_int
    library.gtmr_guard_step.argtypes = [pointer, number, *[pointer] * 4, number, number, pointer]
    return library
