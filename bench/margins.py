# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How far flights come closer than their plans said, against the margins of ``offset_free``.

Run with ``python bench/margins.py --world paper --vertices 12``: of so many vertices of the box,
drawn by seed 1, each flies 20 s under ``worst-case`` and under ``l1`` gusts.
"""

import argparse
import json

import numpy as np

from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.closed_loop import l1_sequence
from gtmr_sim import Scenario, Simulation, World
from gtmr_study.campaign.study import controller_for

STEPS = 800
"""Of a flight."""
STAGES = (1, 2, 5, 10, 15, 20)
"""Of which the use of the margin is told."""


def main() -> None:
    """Fly, and print a JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--world", default="paper")
    parser.add_argument("--vertices", type=int, default=12)
    given = parser.parse_args()
    world = World.load("world", given.world)
    config = ControllerConfig.load("controller", controller_for(world))
    gusts = {"worst-case": {}, "l1": {"sequence": l1_sequence(config, "offset_free")}}
    controller = Controller(config, "offset_free")
    drawn = np.random.default_rng(1).choice(512, given.vertices, replace=False)
    plans, outside, used = 0, 0, np.zeros(config.horizon + 1)
    for kind, more in gusts.items():
        for zeta in config.uncertainty.vertices()[drawn]:
            scenario = Scenario(
                zeta=tuple(zeta), gust={"kind": kind, **more}, world=world, guard="hold"
            )
            closer, alpha = fly(controller, Simulation(scenario, config.sampling_time_s))
            plans, outside = plans + len(closer), outside + int((closer > alpha).any(1).sum())
            used = np.maximum(used, (closer / alpha).max(axis=0))
    result = {
        "world": given.world,
        "plans": plans,
        "outside": outside,
        "outside_share": outside / plans,
        "most_of_the_margin_used": {stage: round(float(used[stage]), 2) for stage in STAGES},
    }
    print(json.dumps(result, indent=2))


def fly(controller: Controller, simulation: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """By how much d_T is less than each plan's, and its margins [m], shape (K, N + 1)."""
    config, late_s = controller.config, simulation.scenario.world.odometry.delay_s
    late = round(late_s / config.sampling_time_s)
    controller.reset()
    flown, planned, margins = [], {}, {}
    for k in range(STEPS):
        flown.append(float(config.tower.clearance(simulation.x)))
        measured = simulation.measured()
        if measured is not None:
            t, x = measured
            solution = controller.step(t, x, now=t + late_s)
            planned[k] = config.tower.clearance(solution.x_plan)
            margins[k] = solution.alpha_p + solution.alpha_g
            simulation.command(t + late_s, solution.u_plan, solution.setpoints_hz)
        simulation.advance(config.sampling_time_s)
    n, at = config.horizon, np.array(flown)
    # The first plans of a late world act later than they are made.
    kept = [k for k in planned if late < k < STEPS - n]
    closer = np.array([planned[k] - at[k : k + n + 1] for k in kept])
    return closer, np.array([margins[k] for k in kept])


if __name__ == "__main__":
    main()
