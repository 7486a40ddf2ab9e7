# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A policy in the Gymnasium environment of the arena, and the same as a controller of its own.

In place of `Policy` comes what you learned. It flies among all others with
gtmr arena --quick --controllers examples/10_learn.py:Learned,offset_free --out DIR
"""

import gymnasium
import numpy as np

from gtmr_study.arena.environment import largest_acceleration, observation


class Policy:
    """Written by hand: what pulls back to the reference, shared out to the rotors."""

    def __init__(self, config):
        self.vehicle = config.vehicle
        self.to_rotors = np.linalg.pinv(config.vehicle.allocation)
        self.largest = largest_acceleration(config)

    def act(self, seen):
        """Actions, -1 to 1, shape (N_p,), for an observation, shape (13 + N_p,)."""
        position, velocity, attitude, rate = np.split(seen[:12], 4)
        pull = np.array([0.0, 0.0, 9.81]) - 40.0 * position - 12.0 * velocity
        force = self.vehicle.mass_kg * pull
        torque = self.vehicle.inertia_kg_m2 * (-150.0 * attitude - 25.0 * rate)
        squared = self.to_rotors @ np.r_[force, torque]
        speeds = np.sqrt(np.clip(squared, 16.0**2, 100.0**2))
        return np.clip(40.0 * (speeds - seen[12:-1]) / self.largest, -1.0, 1.0).astype(np.float32)


class Learned:
    """The policy as a controller, for ``gtmr arena`` and ``gtmr fly``."""

    def __init__(self, config):
        self.config, self.policy = config, Policy(config)

    def step(self, t, x):
        """Rotor accelerations [Hz/s], shape (N_p,), for state x at time t [s]."""
        return self.policy.largest * self.policy.act(observation(self.config, t, x))


if __name__ == "__main__":
    env = gymnasium.make("gtmr/Tower-v0", world="paper", d_ref_m=0.35, duration_s=5.0)
    policy = Policy(env.unwrapped.config)
    for seed in range(3):
        seen, info = env.reset(seed=seed)
        total, least_m, over = 0.0, info["clearance_m"], False
        while not over:
            seen, reward, terminated, truncated, info = env.step(policy.act(seen))
            total, least_m = total + reward, min(least_m, info["clearance_m"])
            over = terminated or truncated
        print(f"seed {seed}: {total:.0f} of 200 points, least clearance {least_m:.3f} m")
