# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the tower's wall does to rotors beside it: suction, and a loss of thrust."""

from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from pydantic import Field

from gtmr_model import Tower, Vehicle, YamlModel
from gtmr_model.dynamics import ATTITUDE, POSITION, ROTORS, rotation


class Wall(YamlModel):
    """Near-wall effects, each rotor by the distance of its hub from the wall.

    Both fade as exp(-d / decay_m), d the distance of the hub from the surface, 0 inside. That
    walls pull multirotors, more the closer and the faster the rotors, is measured by Yang et al.
    (arXiv 2509.21496, 2025); that small rotors lose thrust beside walls, 7 % at 1.5 rotor radii
    from two of them, by "Thrust variations in small rotors due to corner and vertex effects on
    the ground side" (Aeronautical Journal, 2025). The size at this vehicle is assumed.
    """

    suction_n: float = Field(0.0, ge=0.0)
    """Pull on the whole vehicle, towards the tower's axis, while it is level with its x axis
    towards the tower and its centre ``reference_m`` from the wall [N]."""
    thrust_loss: float = Field(0.0, ge=0.0, lt=1.0)
    """Share of its thrust that a rotor loses whose hub is at the wall [-]."""
    decay_m: float = Field(0.3, gt=0.0)
    """Distance over which both fall to 1/e [m]: some two rotor radii; assumed."""
    reference_m: float = Field(0.35, gt=0.0)
    """Clearance of the vehicle's centre at which the pull is ``suction_n`` [m]: the paper's
    d_ref."""


def wall_effect(wall: Wall, x: Any, zeta: Any, vehicle: Vehicle, tower: Tower) -> tuple[Any, Any]:
    """Force, world frame [N], and torque, body frame [N m], symbolic: see `gtmr_sim.plant.Effect`.

    The pull acts on the hubs, horizontally towards the tower's axis.
    """
    to_world, xi = rotation(x[ATTITUDE]), x[ROTORS]
    share = wall.suction_n / _pull_at_reference(wall, vehicle, tower)
    force, torque = ca.SX(3, 1), ca.SX(3, 1)
    for i, rotor in enumerate(vehicle.rotors):
        arm = ca.DM(rotor.position_m)
        hub = x[POSITION] + to_world @ arm
        rho = ca.sqrt(hub[0] * hub[0] + hub[1] * hub[1])
        nearness = ca.exp(-ca.fmax(rho - tower.radius_m, 0.0) / wall.decay_m)
        pull = to_world.T @ ca.vertcat(-hub[0] / rho, -hub[1] / rho, 0.0) * (share * nearness)
        lost = wall.thrust_loss * nearness * (1.0 + zeta[4]) * xi[i] * xi[i]
        thrust = -lost * vehicle.force_coefficient_n_per_hz2 * ca.DM(rotor.axis)
        force += pull + thrust
        torque += ca.cross(arm, pull + thrust)
    return to_world @ force, torque


def _pull_at_reference(wall: Wall, vehicle: Vehicle, tower: Tower) -> float:
    """Sum over the hubs of exp(-d / decay_m), inward, where ``suction_n`` is the whole pull."""
    hubs = np.array([rotor.position_m for rotor in vehicle.rotors])
    outward = tower.radius_m + wall.reference_m - hubs[:, 0]
    rho = np.hypot(outward, hubs[:, 1])
    nearness = np.exp(-np.maximum(rho - tower.radius_m, 0.0) / wall.decay_m)
    return float(nearness @ (outward / rho))


def effect_of(wall: Wall) -> Any:
    """Make the effect of a wall, to insert into a plant."""
    return partial(wall_effect, wall)
