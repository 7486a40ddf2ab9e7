# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Settings of the guard beside the vehicle and the tower: limits, times and gains."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gtmr_model import Tower, Vehicle, YamlModel
from gtmr_model.vehicle import GRAVITY_M_S2

Array = NDArray[np.float64]


MAX_DELAY_S = 0.2
"""Delay and lag beyond which the guard slows no further [s]."""


class GuardConfig(YamlModel):
    """Limits, times and gains of the guard; docs/guard.md says how they were chosen."""

    patience_s: float = Field(0.02, ge=0.0)
    """How long past the plan's end the rotors hold their speeds before it takes charge [s]."""
    max_plan_age_s: float = Field(0.25, gt=0.0)
    """Oldest plan that may be in play, however long it is [s]."""
    retreat_clearance_m: float = Field(1.0, gt=0.0)
    """d_T at which it hovers; where it is further out already, it stays there [m]."""
    retreat_speed_m_s: float = Field(0.6, gt=0.0)
    """Most speed that it asks for on its way [m/s]."""
    max_acceleration_m_s2: float = Field(4.0, gt=0.0)
    """Most acceleration that it asks for, sideways and down; up it is that of gravity [m/s^2]."""
    stopped_m_s: float = Field(0.1, gt=0.0)
    """Speed along the tower's surface below which braking is over and the place is held [m/s]."""
    max_tilt_deg: float = Field(45.0, gt=0.0, lt=180.0)
    """Tilt of the vehicle beyond which no controller is trusted [deg]."""
    max_speed_m_s: float = Field(5.0, gt=0.0)
    """Speed beyond which no controller is trusted [m/s]."""
    max_rate_rad_s: float = Field(6.0, gt=0.0)
    """Body rate beyond which no controller is trusted [rad/s]."""
    max_command_ratio: float = Field(10.0, ge=1.0)
    """Commanded rotor acceleration, in limits of the vehicle, beyond which it is unusable [-]."""
    zone_ratio: float = Field(0.5, ge=0.0, le=1.0)
    """Share of d_min below which the vehicle must move outward [-]."""
    zone_time_s: float = Field(0.5, gt=0.0)
    """How long it may stay without moving outward [s]."""
    reaction_s: float = Field(0.3, ge=0.0)
    """Time until its braking takes effect [s]."""
    brake_m_s2: float = Field(2.0, gt=0.0)
    """Deceleration that it is sure of then [m/s^2]. It takes charge of a vehicle that these two
    would bring to a stop closer to the tower than ``zone_ratio`` allows."""
    delay_s: float = Field(0.0, ge=0.0, le=MAX_DELAY_S)
    """Delay of measurements and lag of motors together, for which it slows its gains [s]."""
    handback_s: float = Field(0.1, gt=0.0)
    """How long all conditions must hold before the controller flies again [s]."""
    fresh_s: float = Field(0.06, gt=0.0)
    """How old a plan may be to hand back to it: its first inputs were not flown [s]."""
    position_filter_rad_s: float = Field(8.0, gt=0.0)
    """Poles of the estimate of velocity and disturbing acceleration [rad/s]."""
    attitude_filter_rad_s: float = Field(20.0, gt=0.0)
    """Poles of the estimate of body rate and disturbing angular acceleration [rad/s]."""
    position_gain: float = Field(1.0, gt=0.0)
    """Speed asked for per distance from the target [1/s]."""
    velocity_gain: float = Field(4.0, gt=0.0)
    """Acceleration asked for per speed error [1/s]."""
    attitude_gain: float = Field(4.0, gt=0.0)
    """Body rate asked for per angle between thrust axis and wanted force [1/s]."""
    rate_gain: float = Field(13.0, gt=0.0)
    """Angular acceleration asked for per rate error [1/s]."""
    rotor_gain: float = Field(40.0, gt=0.0)
    """Rotor acceleration asked for per rotor speed error [1/s]."""

    @classmethod
    def told(cls, plan_step_s: float, delay_s: float, lag_s: float) -> GuardConfig:
        """Set it up for a loop: time between plans, age of measurements, motor lag [s].

        A controller that plans seldom may miss two plans as well, and late measurements make plans
        late.
        """
        usual = cls()
        return cls(
            patience_s=usual.patience_s + delay_s,
            max_plan_age_s=max(usual.max_plan_age_s, 3.0 * plan_step_s) + delay_s,
            fresh_s=max(usual.fresh_s, 2.0 * plan_step_s) + delay_s,
            delay_s=min(delay_s + lag_s, MAX_DELAY_S),
        )


CAUSES = ("", "command unusable", "plan ended", "tilt", "speed", "zone")
"""Why the guard is in charge, by ``gtmr_guard_cause``; the first is that it is not."""


class Parameters(NamedTuple):
    """All numbers of a guard, field by field ``gtmr_guard_parameters`` of ``c/gtmr_guard.h``."""

    inertia_kg_m2: Array
    """J, shape (3,) [kg m^2]."""
    allocation: Array
    """Force [N] and torque [N m] per squared rotor speed [Hz^2], shape (6, N_p)."""
    inverse: Array
    """Squared rotor speeds per force and torque, shape (N_p, 6)."""
    mass_kg: float
    min_rotor_speed_hz: float
    max_rotor_speed_hz: float
    max_rotor_acceleration_hz_s: float
    min_thrust_n: float
    """Least thrust along the body's z axis, so that torque remains [N]."""
    max_thrust_n: float
    """Most thrust, for the same reason [N]."""
    tower_radius_m: float
    min_clearance_m: float
    patience_s: float
    max_plan_age_s: float
    retreat_clearance_m: float
    retreat_speed_m_s: float
    max_acceleration_m_s2: float
    stopped_m_s: float
    min_tilt_cosine: float
    max_speed_m_s: float
    max_rate_rad_s: float
    max_command_hz_s: float
    zone_m: float
    zone_time_s: float
    reaction_s: float
    brake_m_s2: float
    handback_s: float
    fresh_s: float
    position_filter_rad_s: float
    attitude_filter_rad_s: float
    position_gain: float
    velocity_gain: float
    attitude_gain: float
    rate_gain: float
    rotor_gain: float


SLOWED = (
    "position_filter_rad_s",
    "attitude_filter_rad_s",
    "position_gain",
    "velocity_gain",
    "attitude_gain",
    "rate_gain",
    "rotor_gain",
)
"""Fields that a delay makes slower."""
HALVING_DELAY_S = 0.06
"""Delay that halves all of them [s]."""
TORQUE_RESERVE = 0.1
"""Share of the rotors' range of squared speeds that thrust leaves to torque at either end [-]."""


def parameters(vehicle: Vehicle, tower: Tower, config: GuardConfig) -> Parameters:
    """Gather the numbers of a guard; it inverts the allocation, where it has rank 6 as a whole."""
    allocation = vehicle.allocation
    inverse = np.zeros((vehicle.n_rotors, 6))
    # A vehicle that cannot push sideways tilts; asking it for both would cost torque.
    reachable = slice(0, 6) if np.linalg.matrix_rank(allocation) == 6 else slice(2, 6)
    inverse[:, reachable] = np.linalg.pinv(allocation[reachable])
    weight = vehicle.mass_kg * GRAVITY_M_S2
    hover = inverse[:, 2] * weight
    low, high = vehicle.min_rotor_speed_hz**2, vehicle.max_rotor_speed_hz**2
    reserve = TORQUE_RESERVE * (high - low)
    own = {name: getattr(config, name) for name in Parameters._fields if hasattr(config, name)}
    slowing = 1.0 + config.delay_s / HALVING_DELAY_S
    own |= {name: own[name] / slowing for name in SLOWED}
    return Parameters(
        inertia_kg_m2=np.array(vehicle.inertia_kg_m2),
        allocation=allocation,
        inverse=inverse,
        mass_kg=vehicle.mass_kg,
        min_rotor_speed_hz=vehicle.min_rotor_speed_hz,
        max_rotor_speed_hz=vehicle.max_rotor_speed_hz,
        max_rotor_acceleration_hz_s=vehicle.max_rotor_acceleration_hz_s,
        min_thrust_n=weight * min(1.0, float(np.max((low + reserve) / hover))),
        max_thrust_n=weight * max(1.0, float(np.min((high - reserve) / hover))),
        tower_radius_m=tower.radius_m,
        min_clearance_m=tower.min_clearance_m,
        min_tilt_cosine=math.cos(math.radians(config.max_tilt_deg)),
        max_command_hz_s=config.max_command_ratio * vehicle.max_rotor_acceleration_hz_s,
        zone_m=config.zone_ratio * tower.min_clearance_m,
        **own,
    )
