# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Rotors as speed-controlled motors, which follow setpoints as those of an ESC do."""

from typing import Any

import casadi as ca
from pydantic import Field

from gtmr_model import Vehicle, YamlModel


class Motors(YamlModel):
    """Motors with a speed loop: first-order lag within the limits of the vehicle.

    RotorS (Furrer et al., 2016) models the motors of a hexarotor of 1.5 kg like this, with 25 ms.
    """

    lag_s: float = Field(gt=0.0, le=0.5)
    """Time constant T of xi' = (xi_setpoint - xi) / T [s]; |xi'| stays below the vehicle's
    ``max_rotor_acceleration_hz_s``."""
    transport_s: float = Field(0.0, ge=0.0, le=0.1)
    """How long a command takes to the motors [s]."""


def acceleration(xi: Any, setpoint: Any, motors: Motors, vehicle: Vehicle) -> Any:
    """Rotor acceleration [Hz/s] at speeds and setpoints [Hz], all of shape (N_p,), symbolic."""
    low, high = vehicle.min_rotor_speed_hz, vehicle.max_rotor_speed_hz
    wanted = ca.fmin(ca.fmax(setpoint, low), high)
    limit = vehicle.max_rotor_acceleration_hz_s
    return ca.fmin(ca.fmax((wanted - xi) / motors.lag_s, -limit), limit)
