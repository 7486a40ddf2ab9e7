# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The flights of the arena as a Gymnasium environment, for those who learn a controller.

Importing this registers ``gtmr/Tower-v0``::

    import gymnasium
    import gtmr_study.arena.environment

    env = gymnasium.make("gtmr/Tower-v0", world="field", d_ref_m=0.30)

What was learned flies in the arena as any class of one's own does: its ``step(t, x)`` gives
`observation` to the policy and scales what comes out by `largest_acceleration`.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Space
from numpy.typing import NDArray

from gtmr_model.dynamics import ATTITUDE, POSITION, RATE, ROTORS, VELOCITY
from gtmr_nmpc import ControllerConfig
from gtmr_sim import World
from gtmr_sim.scenario import whole_steps
from gtmr_sim.simulation import Simulation
from gtmr_study.campaign.study import Study, at_distance

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

LOST_M = 2.0
"""How far from the reference an episode ends [m]."""
FAST_M_S = 10.0
"""Largest velocity error that is observed [m/s]."""
FAST_RAD_S = 20.0
"""Largest body rate that is observed [rad/s]."""
OFF_M = 0.1
"""Distance from the reference at which a step is worth nothing [m]."""
EFFORT = 0.01
"""What a step with all rotors at the limit of their acceleration costs [-]."""
VIOLATION = 1.0
"""What a step with d_T < d_min costs [-]."""
END = 10.0
"""What hitting the tower, or getting lost, costs [-]."""


def observation(config: ControllerConfig, t: float, x: Array) -> Array32:
    """Give what a policy sees of state x, shape (12 + N_p,), at time t [s].

    In the frame of the reference's heading (x towards the tower, z up): position error [m],
    velocity error [m/s]; roll, pitch and heading error [rad]; body rates less the reference's yaw
    rate [rad/s]; rotor speeds [Hz]; d_T - d_min [m]. Shape (13 + N_p,), within the bounds of the
    observation space.
    """
    reference = config.helix.at(t, config.tower)
    yaw = float(reference.yaw[0])
    c, s = np.cos(yaw), np.sin(yaw)
    to_heading = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    heading_error = (x[ATTITUDE][2] - yaw + np.pi) % (2.0 * np.pi) - np.pi
    seen = np.concatenate(
        [
            to_heading @ (x[POSITION] - reference.position[0]),
            to_heading @ (x[VELOCITY] - reference.velocity[0]),
            x[ATTITUDE][:2],
            [heading_error],
            x[RATE] - [0.0, 0.0, float(reference.yaw_rate[0])],
            x[ROTORS],
            config.tower.clearance(x[None]) - config.tower.min_clearance_m,
        ]
    )
    clipped: Array32 = np.clip(np.nan_to_num(seen).astype(np.float32), *bounds(config))
    return clipped


def bounds(config: ControllerConfig) -> tuple[Array32, Array32]:
    """Bounds of `observation`: what is beyond them is seen as being at them."""
    vehicle, tower = config.vehicle, config.tower
    n = vehicle.n_rotors
    errors = [LOST_M] * 3 + [FAST_M_S] * 3 + [np.pi] * 3 + [FAST_RAD_S] * 3
    inside_m = -tower.min_clearance_m - tower.radius_m
    low = [-each for each in errors] + [vehicle.min_rotor_speed_hz] * n + [inside_m]
    high = errors + [vehicle.max_rotor_speed_hz] * n + [10.0]
    return np.array(low, np.float32), np.array(high, np.float32)


def largest_acceleration(config: ControllerConfig) -> float:
    """Rotor acceleration of an action of 1 [Hz/s]."""
    return float(config.vehicle.max_rotor_acceleration_hz_s)


class TowerFlight(gymnasium.Env[Array32, Array32]):
    """Follow the helix around the tower, close to it and never closer than d_min.

    An action is the acceleration of each rotor as a share of the largest one, -1 to 1, shape
    (N_p,), held for a sampling time. Observations are those of `observation`, of the measured
    state: late and noisy where the world says so.

    A step is worth ``1 - min(1, (|p - p_ref| / 0.1 m)^2) - 0.01 mean(action^2)``, of the true
    state after it; 1 less while d_T < d_min; and 10 less if it ends the episode: if the vehicle's
    centre is in the tower, or more than 2 m off the reference (terminated). At the duration it is
    truncated.

    Each episode has another true mismatch, other gusts and other noise, drawn by the seed given
    to ``reset``; ``options={"trial": k}`` flies trial k of an arena of seed 0. ``info`` has
    ``trial``, ``zeta``, shape (9,), and ``clearance_m``, the true d_T.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 -- as its base has it

    def __init__(
        self,
        world: str = "paper",
        d_ref_m: float | None = None,
        duration_s: float = 20.0,
        render_mode: str | None = None,
    ) -> None:
        """Make it in a world, a preset's name or a YAML file, with the reference at d_ref [m].

        ConfigError if there is no such world, or can be no such reference or duration.
        """
        study = Study(world=World.load("world", world), duration_s=duration_s)
        config = at_distance(study.controller, d_ref_m)
        self.config = config
        self.render_mode = render_mode
        self.observation_space: Space[Array32] = Box(*bounds(config), dtype=np.float32)
        self.action_space: Space[Array32] = Box(
            -1.0, 1.0, (config.vehicle.n_rotors,), dtype=np.float32
        )
        self._study = study.model_copy(update={"controller": config})
        self._steps = whole_steps(
            "duration_s", duration_s, "sampling_time_s", config.sampling_time_s
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Start an episode; see the class for seed and options."""
        super().reset(seed=seed)
        given = (options or {}).get("trial")
        self._trial = int(self.np_random.integers(2**31)) if given is None else int(given)
        scenario = self._study.scenario(self._trial)
        self._simulation = Simulation(scenario, self.config.sampling_time_s)
        self._step = 0
        self._see()
        return self._seen.copy(), self._info()

    def step(self, action: Array32) -> tuple[Array32, float, bool, bool, dict[str, Any]]:
        """Fly one sampling time."""
        action = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        simulation, tower = self._simulation, self.config.tower
        u = largest_acceleration(self.config) * action
        simulation.command(simulation.time_s, u[None])
        with np.errstate(all="ignore"):
            simulation.advance(self.config.sampling_time_s)
        self._step += 1
        self._see()
        x = simulation.x
        reference = self.config.helix.at(simulation.time_s, tower).position[0]
        off_m = float(np.linalg.norm(x[POSITION] - reference))
        d_T = self._clearance_m()
        reward = 1.0 - min(1.0, (off_m / OFF_M) ** 2) - EFFORT * float(np.mean(action**2))
        reward -= VIOLATION * (d_T < tower.min_clearance_m)
        terminated = not (off_m <= LOST_M and simulation.least_clearance_m > 0.0)
        reward -= END * terminated
        truncated = not terminated and self._step >= self._steps
        return self._seen.copy(), float(reward), terminated, truncated, self._info()

    def _see(self) -> None:
        """Take the newest measurement, if one has arrived."""
        newest = self._simulation.measured()
        if newest is not None:
            stamp_s, x = newest
            self._seen = observation(self.config, stamp_s, x)

    def _clearance_m(self) -> float:
        return float(self.config.tower.clearance(self._simulation.x[None])[0])

    def _info(self) -> dict[str, Any]:
        zeta = self._simulation.scenario.zeta_array
        return {"trial": self._trial, "zeta": zeta, "clearance_m": self._clearance_m()}


gymnasium.register("gtmr/Tower-v0", entry_point="gtmr_study.arena.environment:TowerFlight")
