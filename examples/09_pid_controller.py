# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A cascade of PIDs for rotors that push into any direction, flown against the robust NMPC.

It counts on odometry at once and rotors that take accelerations, as in the world `paper`. Against
all others there: gtmr arena --worlds paper --controllers examples/09_pid_controller.py:Pid,...
"""

import numpy as np

from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import Scenario, fly

KP, KV, KI = 9.0, 6.0, 6.0  # of position [1/s^2], velocity [1/s] and the integral [1/s^3]
KR, KW = 64.0, 16.0  # of attitude [1/s^2] and body rates [1/s]
ROTOR_LOOP_S = 0.05  # how fast rotors are brought to their speeds


class Pid:
    """Errors ask for accelerations, the allocation matrix turns them into rotor speeds."""

    def __init__(self, config: ControllerConfig):
        self.config = config
        self.to_squared_speeds = np.linalg.pinv(config.vehicle.allocation)
        self.integral = np.zeros(3)

    def step(self, t, x):
        """Rotor accelerations [Hz/s], shape (N_p,), for state x at time t [s]."""
        vehicle, at = self.config.vehicle, self.config.helix.at(t, self.config.tower)
        p, (roll, pitch, yaw), v, omega, speeds = np.split(x, [3, 6, 9, 12])

        off = at.position[0] - p
        self.integral = np.clip(self.integral + KI * self.config.sampling_time_s * off, -4.0, 4.0)
        wanted = KP * off + KV * (at.velocity[0] - v) + self.integral + at.acceleration[0]
        force = vehicle.mass_kg * np.add(wanted, [0.0, 0.0, 9.81])

        turn = (at.yaw[0] - yaw + np.pi) % (2.0 * np.pi) - np.pi
        turning = KR * np.array([-roll, -pitch, turn]) - KW * omega
        turning[2] += KW * at.yaw_rate[0]
        torque = np.array(vehicle.inertia_kg_m2) * turning

        c, s = np.cos(yaw), np.sin(yaw)
        tilted = np.array([[1.0, 0.0, -pitch], [0.0, 1.0, roll], [pitch, -roll, 1.0]])
        to_body = tilted @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        squared = self.to_squared_speeds @ np.r_[to_body @ force, torque]
        low, high = vehicle.min_rotor_speed_hz, vehicle.max_rotor_speed_hz
        return (np.sqrt(np.clip(squared, low**2, high**2)) - speeds) / ROTOR_LOOP_S


if __name__ == "__main__":
    config = ControllerConfig()
    scenario = Scenario(seed=3).sampled()
    for controller in (Pid(config), Controller(config, "robust")):
        log = fly(scenario, controller, duration_s=20.0)
        rms = np.sqrt(np.mean((log.d_T - config.helix.offset_m) ** 2))
        name = type(controller).__name__
        print(f"{name}: least clearance {log.d_T.min():.3f} m, {rms:.3f} m RMS off the reference")
