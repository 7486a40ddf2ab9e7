# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The guard: watches the commands to the actuators, and flies when there are none to follow."""

from __future__ import annotations

from typing import Protocol

from gtmr_codegen.library import CompileError, warn_interpreted
from gtmr_guard.compiled import CompiledGuard
from gtmr_guard.config import CAUSES, Array, GuardConfig, Parameters, parameters
from gtmr_guard.reference import ReferenceGuard
from gtmr_model import Tower, Vehicle


class GuardLaw(Protocol):
    """What the C and the NumPy implementation have in common."""

    def reset(self) -> None:
        """Forget the flight."""
        ...

    def reconfigure(self, parameters: Parameters) -> None:
        """Go on with other numbers."""
        ...

    def step(
        self, dt_s: float, x: Array, u_due: Array, overdue_s: float, age_s: float
    ) -> tuple[int, Array]:
        """See `Guard.step`; gives the cause by its index in `CAUSES`, too."""
        ...


class Guard:
    """The backup at the actuators of one vehicle.

    It knows the nominal vehicle, the tower and its own settings, and measures position, attitude
    and rotor speeds; velocity, body rate and disturbances it estimates itself, from the first step
    on. In C, or in NumPy with the same answers where there is no compiler, which it says.
    """

    def __init__(self, vehicle: Vehicle, tower: Tower, config: GuardConfig | None = None) -> None:
        self._vehicle, self._config = vehicle, config or GuardConfig()
        numbers = parameters(vehicle, tower, self._config)
        self._law: GuardLaw
        try:
            self._law = CompiledGuard(numbers)
        except CompileError as error:
            warn_interpreted(error)
            self._law = ReferenceGuard(numbers)
        self._cause = 0

    @property
    def active(self) -> bool:
        """Whether it is in charge."""
        return self._cause != 0

    @property
    def cause(self) -> str:
        """Why it is in charge, one of `CAUSES`; empty if it is not."""
        return CAUSES[self._cause]

    @property
    def cause_index(self) -> int:
        """Why it is in charge, by its index in `CAUSES`."""
        return self._cause

    @property
    def addresses(self) -> tuple[int, int] | None:
        """Where ``gtmr_guard_step`` and its memory are; None where it is not compiled.

        What steps it through them sees for itself whether it is in charge.
        """
        return self._law.addresses if isinstance(self._law, CompiledGuard) else None

    def reset(self) -> None:
        """Forget the flight."""
        self._law.reset()
        self._cause = 0

    def reconfigure(self, tower: Tower) -> None:
        """Go on about another tower."""
        self._law.reconfigure(parameters(self._vehicle, tower, self._config))

    def step(self, dt_s: float, x: Array, u_due: Array, overdue_s: float, age_s: float) -> Array:
        """Check the vehicle and the plan in play, and return the command for the rotors.

        Parameters
        ----------
        dt_s : float
            Time since the last step [s]; without meaning in the first one.
        x : ndarray, shape (12 + N_p,)
            Measured state, of which it reads position, attitude and rotor speeds; while any of
            these is no number it goes on by its model.
        u_due : ndarray, shape (N_p,)
            What the plan says for now, rotor accelerations [Hz/s]; zeros past its end, not a
            number if the controller gave what cannot be used.
        overdue_s : float
            How long the plan has been over [s]; negative while it is not.
        age_s : float
            Time since the state that the plan was made for [s].

        Returns
        -------
        ndarray, shape (N_p,)
            Rotor accelerations [Hz/s]: ``u_due`` itself, unless it is in charge.
        """
        self._cause, u = self._law.step(dt_s, x, u_due, overdue_s, age_s)
        return u
