# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The values that the paper leaves out: where each stands in a study, and what it can be."""

from dataclasses import dataclass
from functools import reduce
from operator import attrgetter, getitem
from typing import Any

from gtmr_model import Helix
from gtmr_nmpc import ControllerConfig
from gtmr_sim import GustConfig
from gtmr_study.campaign.study import Study


@dataclass(frozen=True)
class Unreported:
    """A value that the paper does not give."""

    fields: dict[str, float]
    """Where it stands in a study, by path; there it is divided by the number."""
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


def _at(*paths: str) -> dict[str, float]:
    return dict.fromkeys(paths, 1.0)


# fmt: off
UNREPORTED: dict[str, Unreported] = {
    "rotor_acceleration_weight": Unreported(
        _at("controller.weights.rotor_acceleration"),
        "Q_u", "(Hz/s)⁻²", (1e-5, 1e-2), (1e-5, 4e-5, 1e-4, 3e-4, 1e-3)),
    # A plant is compiled for every limit: few of them, so that most sets find theirs.
    "max_rotor_acceleration_hz_s": Unreported(
        _at("controller.vehicle.max_rotor_acceleration_hz_s"), "rotor acceleration limit", "Hz/s",
        (20.0, 200.0), (200.0, 100.0, 50.0, 30.0), logarithmic=False, step=10.0),
    "slack_penalty": Unreported(
        _at("controller.slack_l1", "controller.slack_l2"),
        "clearance penalty", "1/m and 1/m²", (1.0, 1e4), (1000.0, 100.0, 10.0)),
    "attitude_weight": Unreported(
        _at("controller.weights.roll_pitch", "controller.weights.yaw")
        | {"controller.weights.rate": 10.0},
        "attitude weight", "rad⁻²", (1.0, 100.0), (10.0, 100.0)),
    "helix_speed_m_s": Unreported(
        _at("controller.helix.speed_m_s"),
        "helix speed", "m/s", (0.2, 1.5), (0.3, 0.8, 1.2), False),
    "helix_climb_m_s": Unreported(
        _at("controller.helix.climb_m_s"), "helix climb", "m/s", (0.0, 0.2), (), False),
    "gust_std_n": Unreported(
        _at("gust.std_n"), "gust deviation", "N", (0.1, 0.6), (0.1, 0.4), False),
    "gust_correlation_time_s": Unreported(
        _at("gust.correlation_time_s"), "gust correlation time", "s", (0.1, 3.0), (0.1, 2.0)),
    # Compiled in as well, and without much of an effect: not searched.
    "max_rotor_speed_hz": Unreported(
        _at("controller.vehicle.max_rotor_speed_hz"), "rotor speed limit", "Hz", None, (80.0,)),
    "drag_n_s_per_m": Unreported(
        _at("controller.vehicle.drag_n_s_per_m"), "drag", "N s/m", None, (0.3,)),
    "eps_s_m": Unreported(
        _at("controller.eps_s_m"),
        "ε_s", "m", (1e-4, 0.15), (0.001, 0.03, 0.06, 0.09, 0.12, 0.15)),
}
# fmt: on
"""By name."""


def with_values(values: dict[str, float], base: Study) -> Study:
    """Put values by the names of `UNREPORTED` into a study; ConfigError if one is not allowed."""
    Helix.required(base.controller.helix)
    data: Any = {"controller": base.controller.model_dump(), "gust": base.gust.model_dump()}
    for name, value in values.items():
        for path, divisor in UNREPORTED[name].fields.items():
            *parents, field = path.split(".")
            reduce(getitem, parents, data)[field] = value / divisor
    return base.model_copy(
        update={
            "controller": ControllerConfig.parse(data["controller"], "controller"),
            "gust": GustConfig.parse(data["gust"], "gust"),
        }
    )


def values_of(study: Study) -> dict[str, float]:
    """Read the values that the paper leaves out off a study, by the names of `UNREPORTED`."""
    Helix.required(study.controller.helix)
    return {
        name: attrgetter(next(iter(known.fields)))(study) for name, known in UNREPORTED.items()
    }
