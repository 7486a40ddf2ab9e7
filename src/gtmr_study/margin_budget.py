# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""How large the tightening is, by channel, and how large the paper's robust row would need it."""

from __future__ import annotations

from typing import Any

import numpy as np

from gtmr_model import CHANNELS, UncertaintySet
from gtmr_nmpc import Controller, ControllerConfig

ORBIT_SAMPLES = 24
"""How many plans, evenly spread over one turn round the tower, a budget averages."""


def margin_budget(config: ControllerConfig) -> dict[str, float]:
    """Parts of the tightening at the last stage, averaged over a turn round the tower.

    Parameters
    ----------
    config : ControllerConfig
        The controller; it plans from states on the reference.

    Returns
    -------
    dict
        By channel of zeta, then ``eps_s``, ``gust`` and ``total`` [m].
    """
    controller = Controller(config, "robust")
    turn_s = 2.0 * np.pi / config.helix.at(0.0, config.tower).yaw_rate
    parts, gust = [], 0.0
    for start in np.linspace(0.0, 2.0 * np.pi, ORBIT_SAMPLES, endpoint=False):
        helix = config.helix.model_copy(update={"start_angle_rad": float(start)})
        t = start / (2.0 * np.pi) * turn_s
        x = helix.initial_state(config.tower, config.vehicle)
        controller.reset()
        # The first step starts from a vehicle at rest; the next ones from its plan.
        for _ in range(3):
            solution = controller.step(t, x)
        parts.append(solution.alpha_p_by_channel[-1])
        gust = float(solution.alpha_g[-1])
    by_channel = np.mean(parts, axis=0)
    budget = dict(zip(CHANNELS, by_channel.tolist(), strict=True))
    budget |= {"eps_s": config.eps_s_m, "gust": gust}
    return budget | {"total": sum(budget.values())}


def unit_slips(config: ControllerConfig) -> dict[str, ControllerConfig]:
    """Make the controllers that slips of units would give.

    Parameters
    ----------
    config : ControllerConfig
        The paper's, read as it is printed.

    Returns
    -------
    dict
        By what was taken for what.
    """
    mass, box = config.vehicle.mass_kg, config.uncertainty

    def with_box(**changes: Any) -> ControllerConfig:
        return config.model_copy(
            update={"uncertainty": UncertaintySet.parse(box.model_dump() | changes, "slip")}
        )

    as_acceleration = tuple(bound * mass for bound in box.wind_bias_n)
    return {
        "as printed": config,
        "wind bias in m/s² instead of N": with_box(wind_bias_n=as_acceleration),
        "gust in m/s² instead of N": with_box(gust_n=box.gust_n * mass),
        "wind bias and gust in m/s²": with_box(
            wind_bias_n=as_acceleration, gust_n=box.gust_n * mass
        ),
        "inertia of LAAS (a tenth)": config.model_copy(
            update={
                "vehicle": config.vehicle.model_copy(
                    update={"inertia_kg_m2": (0.01155, 0.01137, 0.01944)}
                )
            }
        ),
        "horizon of 1 s (N = 40)": config.model_copy(update={"horizon": 40}),
    }
