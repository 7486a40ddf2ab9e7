# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""Physics and geometry that controller, plant and reports agree on; no ROS in here."""

from gtmr_model.dynamics import dynamics
from gtmr_model.helix import Helix, Reference
from gtmr_model.tower import Tower
from gtmr_model.uncertainty import CHANNELS, N_ZETA, UncertaintySet
from gtmr_model.vehicle import NamedVehicle, Rotor, Vehicle
from gtmr_model.yaml_model import ConfigError, YamlModel

__all__ = [
    "CHANNELS",
    "N_ZETA",
    "ConfigError",
    "Helix",
    "NamedVehicle",
    "Reference",
    "Rotor",
    "Tower",
    "UncertaintySet",
    "Vehicle",
    "YamlModel",
    "dynamics",
]
