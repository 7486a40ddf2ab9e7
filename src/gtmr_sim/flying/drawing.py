# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Pictures of a flight for notebooks and scripts; reports draw their own."""

from __future__ import annotations

from typing import Any

import numpy as np

LIMIT = {"color": "0.4", "linestyle": "--", "linewidth": 1.0}
"""Lines of what must not be passed."""


def draw(log: Any) -> Any:
    """Draw a `FlightLog` over time; gives matplotlib's axes, see its `plot`."""
    import matplotlib.pyplot as plt

    scenario, t = log.scenario, log.t
    vehicle, d_min = scenario.vehicle, scenario.tower.min_clearance_m
    figure, axes = plt.subplots(4, sharex=True, figsize=(8.0, 9.0), layout="constrained")
    clearance, tracking, margins, rotors = axes

    clearance.plot(t, log.d_T, label="centre, $d_T$")
    clearance.plot(t, log.d_airframe, linewidth=1.0, label="airframe")
    reference = scenario.helix.clearance(t, scenario.tower)
    clearance.plot(t, reference, color="0.4", linewidth=1.0, label="reference")
    clearance.axhline(d_min, **LIMIT, label="$d_{min}$")
    clearance.set(ylabel="clearance [m]", title=repr(log))

    tracking.plot(t, log.tracking_error_m, label="all axes")
    tracking.plot(t, log.radial_error_m, linewidth=1.0, label="away from the tower")
    tracking.set(ylabel="tracking error [m]")

    told = {"alpha_p": r"$\alpha_p$", "alpha_g": r"$\alpha_g$", "slack": "slack"}
    for name, label in told.items():
        by_stage = getattr(log, name)
        if by_stage.size:
            margins.plot(t, by_stage.max(axis=1), label=f"{label}, largest of all stages")
    margins.set(ylabel="margins [m]")

    for k, speed in enumerate(log.x[:, 12:].T):
        rotors.plot(t, speed, linewidth=1.0, label=f"rotor {k}")
    for limit in (vehicle.min_rotor_speed_hz, vehicle.max_rotor_speed_hz):
        rotors.axhline(limit, **LIMIT)
    rotors.set(ylabel="rotor speed [Hz]", xlabel="time [s]")

    for each in axes:
        if each.get_legend_handles_labels()[0]:
            each.legend(loc="upper right", fontsize="small", ncols=3)
        each.grid(alpha=0.3)
    if log.guard.any():
        ends = [0.0, 1.0]
        for each in axes:
            # Behind what is drawn, while the guard was in charge.
            each.fill_between(
                t, *ends, where=np.asarray(log.guard), color="0.85", zorder=0,
                transform=each.get_xaxis_transform(),
            )  # fmt: skip
    figure.align_ylabels()
    return axes
