# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Physics and geometry that controller, plant and reports agree on; no ROS in here."""

import time

from gtmr_model.airframe import airframe_clearance
from gtmr_model.dynamics import dynamics
from gtmr_model.helix import Helix
from gtmr_model.reference import Reference, ReferencePath
from gtmr_model.tower import Tower
from gtmr_model.uncertainty import CHANNELS, N_ZETA, UncertaintySet
from gtmr_model.vehicle import NamedVehicle, Rotor, Vehicle
from gtmr_model.yaml_file import ConfigError
from gtmr_model.yaml_model import OneOfKinds, YamlModel

__all__ = [
    "CHANNELS",
    "N_ZETA",
    "ConfigError",
    "Helix",
    "NamedVehicle",
    "OneOfKinds",
    "Reference",
    "ReferencePath",
    "Rotor",
    "Tower",
    "UncertaintySet",
    "Vehicle",
    "YamlModel",
    "airframe_clearance",
    "dynamics",
]

LOADED_NS = time.time_ns()
"""When this package was imported [ns since 1970]."""
