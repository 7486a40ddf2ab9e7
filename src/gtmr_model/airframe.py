# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The vehicle has a size: clearance of its nearest rotor disc, and the constraint on it."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gtmr_model.dynamics import ATTITUDE, POSITION, one_at_a_time, rotation
from gtmr_model.tower import Tower, clearance_constraint
from gtmr_model.vehicle import Vehicle

Array = NDArray[np.float64]

ClearanceOf = Literal["centre", "airframe"]
"""What the clearance is of: the position p, or the nearest rotor disc."""

N_POSE = ATTITUDE.stop
"""Length of [p, eta], the states that the clearance of the airframe depends on."""
BLEND_M = 2e-3
"""Over which difference in clearance [m] the constraint passes from one rotor to the next: its
clearance is smooth, and below the nearest disc's by at most this times ln N_p."""
EDGE_ON = 1e-12
"""Keeps the derivatives finite where a disc's axis points at the tower; enlarges it by less than
a millionth of its radius."""


def disc_distances(pose: Any, vehicle: Vehicle) -> Any:
    """Distance of every rotor disc to the tower's axis [m], shape (N_p,), on CasADi symbols.

    A disc of radius r about the thrust axis n has its hub at c = p + R(eta) p_i. Its horizontal
    extent along a horizontal unit vector d is r sqrt(1 - (n d)^2), its support function, so that
    d c - r sqrt(1 - (n d)^2) is a lower bound of its distance to the axis for any d, and the
    distance itself for the best. Here d points from the tower's axis to the hub: exact
    where the axis leans along d or across it, else too small by a second-order term (for level
    flight of a rotor tilted by 20 degrees, r = 0.15 m and R = 1 m less than 0.1 mm). The tower
    counts as endlessly high.

    Parameters
    ----------
    pose : casadi.SX, shape (6,)
        [p, eta], world ENU [m], roll, pitch, yaw [rad].
    vehicle : Vehicle
        Its rotors.
    """
    turn = rotation(pose[ATTITUDE])
    distances = []
    for rotor in vehicle.rotors:
        hub = pose[POSITION] + turn @ ca.DM(rotor.position_m)
        axis = turn @ ca.DM(rotor.axis)
        distance = ca.sqrt(hub[0] * hub[0] + hub[1] * hub[1])
        lean = (hub[0] * axis[0] + hub[1] * axis[1]) / distance
        extent = vehicle.rotor_radius_m * ca.sqrt(1.0 - lean * lean + EDGE_ON)
        distances.append(distance - extent)
    return ca.vertcat(*distances)


@lru_cache(maxsize=8)
@one_at_a_time
def _disc_function(vehicle: Vehicle) -> ca.Function:
    pose = ca.SX.sym("pose", N_POSE)
    return ca.Function("discs", [pose], [disc_distances(pose, vehicle)])


def airframe_clearance(states: ArrayLike, vehicle: Vehicle, tower: Tower) -> Array:
    """Clearance of the airframe, of its nearest rotor disc [m]; negative inside the tower.

    States, or poses [p, eta], are in the world frame [m, rad]: shape (..., 6) or longer in the
    last axis; the clearance has the shape of the other axes. Never above the true distance, see
    `disc_distances`.
    """
    poses = np.asarray(states, dtype=float)[..., :N_POSE]
    discs = np.asarray(_disc_function(vehicle)(poses.reshape(-1, N_POSE).T))
    return np.asarray(discs.min(axis=0).reshape(poses.shape[:-1]) - tower.radius_m)


@dataclass(frozen=True, eq=False)
class ClearanceConstraint:
    """The clearance constraint of eq. (1), y = d_min - d <= 0, of one thing, with derivatives."""

    function: ca.Function
    """(leading states, [R, d_min], direction) -> y [m], J_yx, d(J_yx direction)/dx."""

    @cached_property
    def length(self) -> int:
        """How many leading states it depends on: 3 for p, 6 for [p, eta]."""
        return self.function.size1_in(0)

    @cached_property
    def states(self) -> tuple[int, ...]:
        """Indices in x of the entries of J_yx, eq. (9), that are not always zero."""
        return tuple(self.function.sparsity_out(1).get_triplet()[1])

    def residual(self, x: Array, tower: Tower) -> Array:
        """Value y [m], shape (n,), at states of shape (n, length) or longer in the last axis."""
        y, _, _ = self.function(x[:, : self.length].T, tower.numbers, np.zeros(self.length))
        return np.asarray(y).ravel()

    def gradient(self, x: Array) -> Array:
        """J_yx at states, shape (n, length) or longer in the last axis; shape (n, length)."""
        nothing = np.zeros(self.length)
        _, gradient, _ = self.function(x[:, : self.length].T, [0.0, 0.0], nothing)
        return np.asarray(gradient).reshape(-1, self.length)

    def curvature(self, x: Array, direction: Array) -> Array:
        """d(J_yx direction)/dx at states, as of `gradient`, and directions; shape (n, length)."""
        at, along = x[:, : self.length].T, direction[:, : self.length].T
        _, _, curvature = self.function(at, [0.0, 0.0], along)
        return np.asarray(curvature).reshape(-1, self.length)


class _CentreConstraint(ClearanceConstraint):
    """Of the vehicle's centre, whose value needs no call of CasADi."""

    def residual(self, x: Array, tower: Tower) -> Array:
        """See `ClearanceConstraint.residual`."""
        return np.asarray(tower.residual(x))


CENTRE = _CentreConstraint(clearance_constraint())
"""The paper's: the vehicle is a point."""


@lru_cache(maxsize=8)
@one_at_a_time
def airframe_constraint(vehicle: Vehicle) -> ClearanceConstraint:
    """Constrain all rotor discs in one row.

    Its clearance is a smooth minimum over them, -b ln(sum_i exp(-d_i / b)) with b = `BLEND_M`,
    which is below the least d_i by at most b ln N_p.
    """
    tower, sizes = Tower().symbolic()
    pose, direction = ca.SX.sym("pose", N_POSE), ca.SX.sym("direction", N_POSE)
    discs = disc_distances(pose, vehicle)
    # The offset of the exponents changes neither the value nor its derivatives.
    nearest = ca.SX.sym("nearest")
    blended = nearest - BLEND_M * ca.log(ca.sum1(ca.exp((nearest - discs) / BLEND_M)))
    y = tower.min_clearance_m - (blended - tower.radius_m)
    gradient = ca.jacobian(y, pose)
    curvature = ca.jacobian(gradient @ direction, pose)
    results = ca.substitute([y, gradient, curvature], [nearest], [ca.mmin(discs)])
    function = ca.Function("airframe", [pose, sizes, direction], results)
    return ClearanceConstraint(function)


def constraint_on(clearance_of: ClearanceOf, vehicle: Vehicle) -> ClearanceConstraint:
    """Choose the constraint on the centre or on a vehicle's airframe."""
    return CENTRE if clearance_of == "centre" else airframe_constraint(vehicle)
