# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Modes of the closed loop along the helix: which motions decay, and how fast."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gtmr_model import Helix
from gtmr_model.dynamics import POSITION, VELOCITY, YAW
from gtmr_nmpc import ControllerConfig
from gtmr_nmpc.reference.rti import RealTimeIteration, Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ClosedLoopModes:
    """Linearised closed loop of the nominal model and converged nominal controller.

    In a frame that moves along the helix the closed loop is time-invariant, so that its
    eigenvalues tell which motions about the steady flight decay.
    """

    steady_state: Array
    """State that repeats itself in the moving frame, shape (12 + N_p,)."""
    eigenvalues: NDArray[np.complex128]
    """Of the map over one sampling time, by falling magnitude, shape (12 + N_p,)."""
    sampling_time_s: float
    """T_s [s]."""

    @property
    def slowest_s(self) -> float:
        """Time constant of the slowest mode [s]; infinite if a mode does not decay."""
        magnitude = abs(self.eigenvalues[0])
        return float(-self.sampling_time_s / np.log(magnitude)) if magnitude < 1.0 else np.inf


def closed_loop_modes(config: ControllerConfig) -> ClosedLoopModes:
    """Linearise the closed loop about its steady flight by central differences."""
    loop = _MovingLoop(config)
    x = config.helix.initial_state(config.tower, config.vehicle)
    for _ in range(4):
        # Newton's method; least norm, since undamped modes leave the steady state undetermined.
        jacobian = loop.jacobian(x)
        gap = loop(x) - x
        x = x - np.linalg.lstsq(jacobian - np.eye(len(x)), gap, rcond=1e-9)[0]
    eigenvalues = np.asarray(np.linalg.eigvals(loop.jacobian(x)), dtype=np.complex128)
    order = np.argsort(-np.abs(eigenvalues))
    return ClosedLoopModes(x, eigenvalues[order], config.sampling_time_s)


class _MovingLoop:
    """One sampling time of closed-loop flight, seen from the helix."""

    def __init__(self, config: ControllerConfig) -> None:
        self._config = config
        self._rti = RealTimeIteration(config)
        self._turn = config.helix.at(0.0, config.tower).yaw_rate[0] * config.sampling_time_s
        self._climb = Helix.required(config.helix).climb_m_s * config.sampling_time_s
        self._back = Rotation.from_euler("Z", -self._turn).as_matrix()
        self._guess: Trajectory | None = None

    def __call__(self, x: Array) -> Array:
        x = self._rti.predict(x, self._converged_input(x))
        x[POSITION] = self._back @ x[POSITION]
        x[2] -= self._climb
        x[VELOCITY] = self._back @ x[VELOCITY]
        x[YAW] -= self._turn
        return x

    def jacobian(self, x: Array) -> Array:
        steps = np.r_[np.full(12, 1e-5), np.full(len(x) - 12, 1e-3)]
        columns = []
        for j, step in enumerate(steps):
            dx = np.zeros(len(x))
            dx[j] = step
            columns.append((self(x + dx) - self(x - dx)) / (2.0 * step))
        return np.array(columns).T

    def _converged_input(self, x: Array) -> Array:
        n, n_u = self._config.horizon, self._config.vehicle.n_rotors
        iterate = self._guess or Trajectory(np.tile(x, (n + 1, 1)), np.zeros((n, n_u)))
        for _ in range(60):
            result = self._rti.feedback(self._rti.prepare(0.0, iterate, "nominal"), x)
            if result is None:
                raise RuntimeError("the QP solver gave up")
            change = float(np.abs(result[0].u - iterate.u).max())
            iterate = result[0]
            if change < 1e-10:
                break
        self._guess = iterate
        return iterate.u[0]
