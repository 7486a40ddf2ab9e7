# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is kept of the steps of a flight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BY_STAGE = ("alpha_p", "alpha_g", "slack")
"""What a controller may tell of each stage of its plan."""


@dataclass(frozen=True)
class Step:
    """What is kept of a controller's step; fields as in `FlightLog`, the whole plan apart."""

    u_plan: Array
    setpoints_hz: Array | None
    alpha_p: Array
    alpha_g: Array
    slack: Array
    solve_ms: float
    failed: bool | None

    @property
    def told(self) -> dict[str, Any]:
        """What the controller tells beside its plan; the same in every step of a flight."""
        shapes = {name: getattr(self, name).shape for name in BY_STAGE}
        return {**shapes, "status": self.failed is not None}

    @classmethod
    def of(cls, result: Any, n_rotors: int, elapsed_s: float) -> Step:
        """Read what ``step`` returned; raises ValueError or TypeError if it cannot be flown."""
        planned = hasattr(result, "u_plan")
        # Copies: the controller may use its arrays again.
        u = np.array(result.u_plan if planned else result, dtype=float)
        if planned and not (u.ndim == 2 and len(u) and u.shape[1] == n_rotors):
            raise ValueError(f"u_plan has shape {u.shape}, expected (n, {n_rotors})")
        if not planned and u.shape != (n_rotors,):
            raise ValueError(
                f"returned shape {u.shape}, expected ({n_rotors},), rotor accelerations [Hz/s]"
            )
        if not np.isfinite(u).all():
            raise ValueError(f"returned {u[~np.isfinite(u)][0]} among the rotor accelerations")
        told = getattr(result, "setpoints_hz", None) if planned else None
        setpoints = None if told is None else np.array(told, dtype=float)
        if setpoints is not None and setpoints.shape != (len(u) + 1, n_rotors):
            raise ValueError(
                f"setpoints_hz has shape {setpoints.shape}, expected ({len(u) + 1}, {n_rotors})"
            )
        if setpoints is not None and not np.isfinite(setpoints).all():
            raise ValueError(f"gave {setpoints[~np.isfinite(setpoints)][0]} among the setpoints")
        stages = {name: getattr(result, name, None) for name in BY_STAGE}
        status = getattr(result, "status", None)
        timing = getattr(result, "timing", None)
        return cls(
            u_plan=u.reshape(-1, n_rotors),
            setpoints_hz=setpoints,
            **{k: np.array(() if v is None else v, dtype=float) for k, v in stages.items()},
            solve_ms=1e3 * (elapsed_s if timing is None else timing.total_s),
            failed=None if status is None else status == "failed",
        )


@dataclass(frozen=True)
class Rows:
    """What is kept of all steps, one row each; fields as in `FlightLog`."""

    x: Array
    x_measured: Array
    u: Array
    w_g: Array
    wind_n: Array
    alpha_p: Array
    alpha_g: Array
    slack: Array
    solve_ms: Array
    failed: NDArray[np.bool_]
    guard: NDArray[np.bool_]
