# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The cost of a robust MPC, by the few numbers that are tuned."""

from __future__ import annotations

from pydantic import Field

from gtmr_nmpc import ControllerConfig
from gtmr_study.rivals.tuning import RivalParameters


class CostParameters(RivalParameters):
    """What the families of robust MPC are tuned by: factors of the paper's cost."""

    position_scale: float = Field(10.0, ge=0.5, le=100.0)
    """Factor of the paper's weights on position, at the end of the horizon too [-]."""
    velocity_scale: float = Field(2.0, ge=0.2, le=20.0)
    """Factor of the paper's weights on velocity [-]."""
    acceleration_scale: float = Field(0.3, ge=0.01, le=3.0)
    """Factor of the paper's weights on acceleration [-]."""
    rotor_acceleration: float = Field(3e-6, ge=3e-7, le=1e-4)
    """Q_u [(Hz/s)^-2]."""

    def weigh(self, config: ControllerConfig) -> ControllerConfig:
        """Give the problem with these weights."""
        old = config.weights
        factors = {
            "position": self.position_scale,
            "terminal_position": self.position_scale,
            "velocity": self.velocity_scale,
            "acceleration": self.acceleration_scale,
        }
        scaled = {
            name: tuple(factor * weight for weight in getattr(old, name))
            for name, factor in factors.items()
        }
        update = {**scaled, "rotor_acceleration": self.rotor_acceleration}
        return config.model_copy(update={"weights": old.model_copy(update=update)})
