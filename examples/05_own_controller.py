# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A controller of your own, an LQR with integral action, against the robust NMPC on one seed.

It counts on odometry at once and rotors that take accelerations, as in the world `paper`. Many
flights: gtmr campaign --controller examples/05_own_controller.py:Lqr --out DIR
"""

import numpy as np
from scipy.linalg import solve_continuous_are

from gtmr_model import N_ZETA, dynamics
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import Scenario, fly


class Lqr:
    """Feedback of the deviation from the helix, linearised about level hover."""

    def __init__(self, config: ControllerConfig):
        self.config, vehicle = config, config.vehicle
        n_x, n_u = vehicle.n_x, vehicle.n_rotors
        self.hover = np.r_[np.zeros(12), vehicle.hover_rotor_speeds_hz]
        self.integral = np.zeros(3)

        def derivative(z):
            return dynamics(z[:n_x], z[n_x:], np.zeros(N_ZETA), np.zeros(3), vehicle)

        z = np.r_[self.hover, np.zeros(n_u)]
        moves = 1e-5 * np.eye(z.size)
        jacobian = np.array([derivative(z + h) - derivative(z - h) for h in moves]).T / 2e-5
        # The integral of the position error is three states more.
        A = np.block([[jacobian[:, :n_x], np.zeros((n_x, 3))], [np.eye(3, n_x + 3)]])
        B = np.vstack([jacobian[:, n_x:], np.zeros((3, n_u))])
        weights = np.repeat([500.0, 50.0, 10.0, 5.0, 1e-3, 500.0], [3, 3, 3, 3, n_u, 3])
        self.gain = 1e5 * B.T @ solve_continuous_are(A, B, np.diag(weights), 1e-5 * np.eye(n_u))

    def step(self, t, x):
        """Rotor accelerations [Hz/s], shape (N_p,), for state x at time t [s]."""
        at = self.config.helix.at(t, self.config.tower)
        yaw = at.yaw[0]
        forward, left = [np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0]
        to_heading = np.array([forward, left, [0.0, 0.0, 1.0]])
        error = x - self.hover
        error[:3] = to_heading @ (x[:3] - at.position[0])
        error[5] = (x[5] - yaw + np.pi) % (2.0 * np.pi) - np.pi
        error[6:9] = to_heading @ (x[6:9] - at.velocity[0])
        error[11] -= at.yaw_rate[0]
        self.integral += self.config.sampling_time_s * error[:3]
        return -self.gain @ np.r_[error, self.integral]


if __name__ == "__main__":
    config = ControllerConfig()
    scenario = Scenario(seed=3).sampled()
    for controller in (Lqr(config), Controller(config, "robust")):
        log = fly(scenario, controller, duration_s=20.0)
        rms = np.sqrt(np.mean((log.d_T - config.helix.offset_m) ** 2))
        name = type(controller).__name__
        print(f"{name}: least clearance {log.d_T.min():.3f} m, {rms:.3f} m RMS off the reference")
