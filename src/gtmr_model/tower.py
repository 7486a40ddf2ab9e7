# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The tower: a vertical cylinder on the z axis of the world frame (Sec. II-A)."""

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from gtmr_model.dynamics import one_at_a_time
from gtmr_model.yaml_model import YamlModel

Array = NDArray[np.float64]


class Tower(YamlModel):
    """A vertical cylinder that the vehicle must keep away from."""

    radius_m: float = Field(1.0, gt=0.0)
    """R [m] (Table I)."""
    min_clearance_m: float = Field(0.2, gt=0.0)
    """d_min, the least admissible clearance [m] (Table I)."""

    def clearance(self, position: ArrayLike | ca.SX) -> Any:
        """Distance to the tower's surface [m], negative inside, d_T(p) = rho(p) - R (Sec. II-A).

        Positions, or states that start with a position, are in the world frame [m]: shape (..., 3)
        or longer in the last axis, or a CasADi symbol.
        """
        p: Any = position
        if not isinstance(p, ca.SX):
            p = np.asarray(p, dtype=float)
            p = p[..., 0], p[..., 1]
        root: Any = ca.sqrt if isinstance(p, ca.SX) else np.sqrt
        return root(p[0] * p[0] + p[1] * p[1]) - self.radius_m

    def residual(self, position: ArrayLike | ca.SX) -> Any:
        """Clearance residual s = d_min - d_T(p) [m]; above zero the constraint (1) is violated.

        Positions are as of `clearance`.
        """
        return self.min_clearance_m - self.clearance(position)


@cache
@one_at_a_time
def clearance_constraint() -> ca.Function:
    """Clearance constraint of eq. (1) with its derivatives, in standard form y <= 0.

    (p, [R, d_min], direction) -> y [m], J_yx, shape (1, 3), which is the position part of eq. (9)
    and the rest of which is zero, and d(J_yx direction)/dp, shape (1, 3).
    """
    tower, sizes = Tower().symbolic()
    p, direction = ca.SX.sym("p", 3), ca.SX.sym("direction", 3)
    y = tower.residual(p)
    gradient = ca.jacobian(y, p)
    curvature = ca.jacobian(gradient @ direction, p)
    return ca.Function("clearance", [p, sizes, direction], [y, gradient, curvature])


def clearance_gradient(positions: Array) -> Array:
    """J_yx at positions [m], shape (n, 3): unit vectors towards the tower [-], shape (n, 3)."""
    _, gradient, _ = clearance_constraint()(positions.T, [0.0, 0.0], [0.0, 0.0, 0.0])
    return np.asarray(gradient).reshape(-1, 3)


def clearance_curvature(positions: Array, direction: Array) -> Array:
    """d(J_yx direction)/dp [1/m] times the unit of the direction; all of shape (n, 3)."""
    _, _, curvature = clearance_constraint()(positions.T, [0.0, 0.0], direction.T)
    return np.asarray(curvature).reshape(-1, 3)
