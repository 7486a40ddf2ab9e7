# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The structured uncertainty zeta, eq. (4), its box, and the gust bound (Sec. III)."""

import itertools
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from gtmr_model.yaml_model import YamlModel

CHANNELS = ("mass", "J_x", "J_y", "J_z", "thrust", "drag", "w_bx", "w_by", "w_bz")
"""Names of the entries of zeta: relative mismatches, then wind bias forces [N], world frame."""
N_ZETA = len(CHANNELS)
"""n_zeta, the length of zeta."""

Fraction = Annotated[float, Field(ge=0.0, lt=1.0)]
Force = Annotated[float, Field(ge=0.0)]


class UncertaintySet(YamlModel):
    """The box Z of zeta, symmetric about zero, and the bound on gusts (Table I)."""

    mass: Fraction = 0.10
    """Bound on the relative mass mismatch [-]."""
    inertia: tuple[Fraction, Fraction, Fraction] = (0.15, 0.15, 0.20)
    """Bounds on the relative mismatch of the principal inertia [-]."""
    thrust: Fraction = 0.10
    """Bound on the relative mismatch of rotor force and torque [-]."""
    drag: Fraction = 0.20
    """Bound on the relative drag mismatch [-]."""
    wind_bias_n: tuple[Force, Force, Force] = (0.8, 0.8, 0.3)
    """Bounds on the persistent wind force, world frame [N]."""
    gust_n: Force = 0.6
    """Bound on the norm of the gust force [N]."""

    @property
    def half_widths(self) -> NDArray[np.float64]:
        """w_bar_zeta of eq. (11): half-widths of the box, shape (9,)."""
        return np.array([self.mass, *self.inertia, self.thrust, self.drag, *self.wind_bias_n])

    def sample(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw zeta, shape (9,), uniformly from the box."""
        return rng.uniform(-1.0, 1.0, N_ZETA) * self.half_widths

    def vertices(self) -> NDArray[np.float64]:
        """All 512 vertices of the box, shape (512, 9)."""
        return np.array(list(itertools.product((-1.0, 1.0), repeat=N_ZETA))) * self.half_widths

    def require_inside(self, zeta: ArrayLike) -> NDArray[np.float64]:
        """Check that zeta, shape (9,), lies in the box, and give it as an array.

        Raises ValueError if the length is wrong or an entry is outside; names the channel, value
        and range.
        """
        array = np.asarray(zeta, dtype=float)
        if array.shape != (N_ZETA,):
            raise ValueError(f"zeta has {array.size} numbers, expected {N_ZETA}: {CHANNELS}")
        for name, value, bound in zip(CHANNELS, array, self.half_widths, strict=True):
            if not abs(value) <= bound:
                raise ValueError(f"zeta[{name}] = {value:g}: allowed is {-bound:g} to {bound:g}")
        return array
