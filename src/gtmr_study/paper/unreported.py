# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The values that the paper leaves out: where each stands in a study, and what it can be."""

from __future__ import annotations

from dataclasses import dataclass

from gtmr_nmpc import ControllerConfig
from gtmr_sim import GustConfig
from gtmr_study.campaign.study import Study


@dataclass(frozen=True)
class Unreported:
    """A value that the paper does not give."""

    label: str
    """What to call it in tables."""
    unit: str
    """Its unit."""
    searched: tuple[float, float] | None
    """Bounds within which a search looks for it; None if it is not searched."""
    tried: tuple[float, ...]
    """Values that the reproduction tries, all else as it is."""
    logarithmic: bool = True
    """Whether it is searched on a logarithmic scale."""
    step: float | None = None
    """Distance of the values that a search tries; None if it may try any."""


UNREPORTED: dict[str, Unreported] = {
    "rotor_acceleration_weight": Unreported(
        "Q_u", "(Hz/s)⁻²", (1e-5, 1e-2), (1e-5, 4e-5, 1e-4, 3e-4, 1e-3)
    ),
    # A plant is compiled for every limit: few of them, so that most sets find theirs.
    "max_rotor_acceleration_hz_s": Unreported(
        "rotor acceleration limit",
        "Hz/s",
        (20.0, 200.0),
        (200.0, 100.0, 50.0, 30.0),
        logarithmic=False,
        step=10.0,
    ),
    "slack_penalty": Unreported(
        "clearance penalty", "1/m and 1/m²", (1.0, 1e4), (1000.0, 100.0, 10.0)
    ),
    "attitude_weight": Unreported("attitude weight", "rad⁻²", (1.0, 100.0), (10.0, 100.0)),
    "helix_speed_m_s": Unreported("helix speed", "m/s", (0.2, 1.5), (0.3, 0.8, 1.2), False),
    "helix_climb_m_s": Unreported("helix climb", "m/s", (0.0, 0.2), (), False),
    "gust_std_n": Unreported("gust deviation", "N", (0.1, 0.6), (0.1, 0.4), False),
    "gust_correlation_time_s": Unreported("gust correlation time", "s", (0.1, 3.0), (0.1, 2.0)),
    # Compiled in as well, and without much of an effect: not searched.
    "max_rotor_speed_hz": Unreported("rotor speed limit", "Hz", None, (80.0,)),
    "drag_n_s_per_m": Unreported("drag", "N s/m", None, (0.3,)),
    "eps_s_m": Unreported("ε_s", "m", (1e-4, 0.15), (0.001, 0.03, 0.06, 0.09, 0.12, 0.15)),
}
"""By name. ``slack_penalty`` is the linear and the quadratic penalty on the clearance constraint,
``attitude_weight`` that of roll, pitch and yaw, and ten times that of the body rates."""


def with_values(values: dict[str, float], base: Study) -> Study:
    """Put values by the names of `UNREPORTED` into a study; ConfigError if one is not allowed."""
    config, gust = base.controller, base.gust
    weights = _named(values, rotor_acceleration="rotor_acceleration_weight")
    if "attitude_weight" in values:
        attitude = values["attitude_weight"]
        weights |= {"roll_pitch": attitude, "yaw": attitude, "rate": attitude / 10.0}
    vehicle = _named(values, "drag_n_s_per_m", "max_rotor_acceleration_hz_s", "max_rotor_speed_hz")
    helix = _named(values, speed_m_s="helix_speed_m_s", climb_m_s="helix_climb_m_s")
    gusts = _named(values, std_n="gust_std_n", correlation_time_s="gust_correlation_time_s")
    controller = config.model_dump() | {
        "weights": config.weights.model_dump() | weights,
        "vehicle": config.vehicle.model_dump() | vehicle,
        "helix": config.helix.model_dump() | helix,
        **_named(values, "eps_s_m", slack_l1="slack_penalty", slack_l2="slack_penalty"),
    }
    return base.model_copy(
        update={
            "controller": ControllerConfig.parse(controller, "controller"),
            "gust": GustConfig.parse(gust.model_dump() | gusts, "gust"),
        }
    )


def values_of(study: Study) -> dict[str, float]:
    """Read the values that the paper leaves out off a study, by the names of `UNREPORTED`."""
    config = study.controller
    return {
        "rotor_acceleration_weight": config.weights.rotor_acceleration,
        "max_rotor_acceleration_hz_s": config.vehicle.max_rotor_acceleration_hz_s,
        "slack_penalty": config.slack_l1,
        "attitude_weight": config.weights.roll_pitch,
        "helix_speed_m_s": config.helix.speed_m_s,
        "helix_climb_m_s": config.helix.climb_m_s,
        "max_rotor_speed_hz": config.vehicle.max_rotor_speed_hz,
        "gust_std_n": study.gust.std_n,
        "gust_correlation_time_s": study.gust.correlation_time_s,
        "drag_n_s_per_m": config.vehicle.drag_n_s_per_m,
        "eps_s_m": config.eps_s_m,
    }


def _named(values: dict[str, float], *same: str, **renamed: str) -> dict[str, float]:
    """Pick values that are given, under the names of the fields they belong to."""
    fields = {name: name for name in same} | renamed
    return {field: values[name] for field, name in fields.items() if name in values}
