# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A controller of your own, an LQR, flown against the robust NMPC on the same seed.

Try it on many flights: gtmr campaign --controller examples/05_own_controller.py:Lqr --out DIR
"""

import numpy as np
from scipy.linalg import solve_continuous_are

from gtmr_model import N_ZETA, dynamics
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import Scenario, fly


class Lqr:
    """Feedback of the deviation from the helix, linearised about level hover."""

    def __init__(self, config: ControllerConfig):
        self.config = config
        vehicle, weights = config.vehicle, config.weights
        self.hover = np.r_[np.zeros(12), vehicle.hover_rotor_speeds_hz]

        def derivative(z):
            x, u = np.split(z, [vehicle.n_x])
            return dynamics(x, u, np.zeros(N_ZETA), np.zeros(3), vehicle)

        z = np.r_[self.hover, np.zeros(vehicle.n_rotors)]
        moves = 1e-5 * np.eye(z.size)
        jacobian = np.array([derivative(z + h) - derivative(z - h) for h in moves]).T / 2e-5
        A, B = np.split(jacobian, [vehicle.n_x], axis=1)
        attitude, rate = [weights.roll_pitch] * 2 + [weights.yaw], [weights.rate] * 3
        spin = [1e-3] * vehicle.n_rotors
        Q = np.diag([*weights.position, *attitude, *weights.velocity, *rate, *spin])
        R = weights.rotor_acceleration * np.eye(vehicle.n_rotors)
        self.gain = np.linalg.solve(R, B.T @ solve_continuous_are(A, B, Q, R))

    def step(self, t, x):
        """Rotor accelerations [Hz/s], shape (N_p,), for state x at time t [s]."""
        reference = self.config.helix.at(t, self.config.tower)
        yaw = reference.yaw[0]
        forward, left = [np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0]
        to_heading = np.array([forward, left, [0.0, 0.0, 1.0]])
        error = x - self.hover
        error[:3] = to_heading @ (x[:3] - reference.position[0])
        error[5] = (x[5] - yaw + np.pi) % (2.0 * np.pi) - np.pi
        error[6:9] = to_heading @ (x[6:9] - reference.velocity[0])
        error[11] -= reference.yaw_rate[0]
        return -self.gain @ error


if __name__ == "__main__":
    config = ControllerConfig()
    scenario = Scenario(seed=3).sampled()
    for controller in (Lqr(config), Controller(config, "robust")):
        log = fly(scenario, controller, duration_s=20.0)
        rms = np.sqrt(np.mean((log.d_T - config.helix.offset_m) ** 2))
        name = type(controller).__name__
        print(f"{name}: least clearance {log.d_T.min():.3f} m, {rms:.3f} m RMS off the reference")
