# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A gust of your own, and a vehicle effect: functions that are registered under a name.

An installed package brings its own by entry points of the groups gtmr.gusts and gtmr.effects;
their names can then stand in YAML, on the command line and in ROS parameters.
"""

import casadi as ca
import numpy as np

from gtmr_nmpc import Controller
from gtmr_sim import EFFECTS, GUSTS, Scenario, fly


@GUSTS.register("squall")
def squall(scenario, start_s, rise_s):
    """Rise once to the full bound, towards the tower, and fall again (1 - cos)."""
    size_n = scenario.uncertainty.gust_n

    def force(time_s, position):
        phase = np.clip((time_s - start_s) / (2.0 * rise_s), 0.0, 1.0)
        towards = -np.r_[position[:2], 0.0] / np.hypot(*position[:2])
        return 0.5 * size_n * (1.0 - np.cos(2.0 * np.pi * phase)) * towards

    return force


@EFFECTS.register("suction")
def suction(x, zeta, vehicle, tower):
    """Pull towards the tower with 0.3 N at its surface, a tenth of that a metre away."""
    rho = ca.norm_2(x[:2])
    force_n = 0.3 * 0.1 ** (rho - tower.radius_m)
    return ca.vertcat(-force_n * x[:2] / rho, 0.0), ca.DM.zeros(3)


if __name__ == "__main__":
    gust = {"kind": "squall", "parameters": {"start_s": 4.0, "rise_s": 0.5}}
    for effects in ([], ["suction"]):
        scenario = Scenario.parse({"gust": gust, "effects": effects}, "own gust")
        log = fly(scenario, Controller(), duration_s=10.0)
        k = log.d_T.argmin()
        print(f"{effects or 'no effect'}: {log.d_T[k]:.3f} m at {log.t[k]:.2f} s")
