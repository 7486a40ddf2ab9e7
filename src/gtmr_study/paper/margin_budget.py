# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How large the tightening is, by channel, and how large the paper's robust row would need it."""

from typing import Any

import numpy as np

from gtmr_model import CHANNELS, Helix
from gtmr_nmpc import Controller, ControllerConfig, Solution

ORBIT_SAMPLES = 24
"""How many plans, evenly spread over one turn around the tower, a budget averages."""
HELIX_SPEEDS_M_S = (0.2, 0.5, 1.0, 1.5, 2.0)
"""Speeds of the helix at which the tightening is looked at [m/s]."""


def margin_budget(config: ControllerConfig) -> dict[str, float]:
    """Parts of the tightening at the last stage, averaged over a turn around the tower [m].

    By channel of zeta, then ``eps_s``, ``gust`` and ``total``.
    """
    plans = _plans_of_a_turn(config)
    by_channel = np.mean([plan.alpha_p_by_channel[-1] for plan in plans], axis=0)
    budget = dict(zip(CHANNELS, by_channel.tolist(), strict=True))
    budget |= {"eps_s": config.eps_s_m, "gust": float(plans[0].alpha_g[-1])}
    return budget | {"total": sum(budget.values())}


def alpha_by_helix_speed(config: ControllerConfig) -> list[dict[str, float]]:
    """List ``alpha_n_m``, the last stage's tightening averaged over a turn, by ``speed_m_s``."""
    rows = []
    for speed_m_s in HELIX_SPEEDS_M_S:
        helix = Helix.required(config.helix).model_copy(update={"speed_m_s": speed_m_s})
        budget = margin_budget(config.model_copy(update={"helix": helix}))
        rows.append({"speed_m_s": speed_m_s, "alpha_n_m": budget["total"]})
    return rows


def hoelder_ratio(config: ControllerConfig) -> float:
    """Compare Hoelder's bound with the parametric margin that the paper uses instead, eq. (12).

    ||Pi_y||_inf ||w||_1 over sum_j |Pi_y,j| w_j at the last stage, the least over a turn around
    the tower [-].
    """
    half_widths = config.uncertainty.half_widths
    parts = np.array([plan.alpha_p_by_channel[-1] for plan in _plans_of_a_turn(config)])
    given = half_widths > 0.0
    sensitivity = parts[:, given] / half_widths[given]
    bound = sensitivity.max(axis=1) * half_widths.sum()
    return float((bound / parts.sum(axis=1)).min())


def _plans_of_a_turn(config: ControllerConfig) -> list[Solution]:
    controller, helix = Controller(config, "robust"), Helix.required(config.helix)
    turn_s = 2.0 * np.pi / helix.at(0.0, config.tower).yaw_rate[0]
    plans = []
    for turned in np.arange(ORBIT_SAMPLES) / ORBIT_SAMPLES:
        t = float(turned * turn_s)
        there = {
            "start_angle_rad": helix.start_angle_rad + 2.0 * np.pi * turned,
            "start_height_m": helix.start_height_m + helix.climb_m_s * t,
        }
        x = helix.model_copy(update=there).initial_state(config.tower, config.vehicle)
        controller.reset()
        # The first step starts from a vehicle at rest; the next ones from its plan.
        for _ in range(3):
            solution = controller.step(t, x)
        plans.append(solution)
    return plans


def unit_slips(config: ControllerConfig) -> dict[str, ControllerConfig]:
    """Make the controllers that slips of units would give, by what was taken for what."""
    mass, box = config.vehicle.mass_kg, config.uncertainty

    def changed(part: str, **fields: Any) -> ControllerConfig:
        of = getattr(config, part)
        return config.model_copy(update={part: type(of).parse(of.model_dump() | fields, "slip")})

    wind_bias = {"wind_bias_n": tuple(bound * mass for bound in box.wind_bias_n)}
    gust = {"gust_n": box.gust_n * mass}
    inertia_kg_m2 = (0.01155, 0.01137, 0.01944)
    return {
        "wind bias in m/s² instead of N": changed("uncertainty", **wind_bias),
        "gust in m/s² instead of N": changed("uncertainty", **gust),
        "wind bias and gust in m/s²": changed("uncertainty", **wind_bias, **gust),
        "inertia of LAAS (a tenth)": changed("vehicle", inertia_kg_m2=inertia_kg_m2),
        "horizon of 1 s (N = 40)": config.model_copy(update={"horizon": 40}),
    }
