# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A constant margin, the same at every stage."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gtmr_nmpc.margins.margin import Iterate, Margin


class FixedMargin(Margin):
    """Nominal control that keeps a constant distance more."""

    kind: str = "fixed"
    """Which margin."""
    margin_m: float = Field(0.01, ge=0.0)
    """By how much every stage is tightened [m]."""

    def tightening(self, iterate: Iterate) -> NDArray[np.float64]:
        """Do not depend on the iterate."""
        return np.full(len(iterate.x), self.margin_m)
