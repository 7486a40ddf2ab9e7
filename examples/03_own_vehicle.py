# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A vehicle of your own: an octorotor with slower rotors.

As a file it is a YAML like those in config/vehicle: see docs/tutorials/own-vehicle.md.
"""

from gtmr_model import Vehicle
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import Scenario, fly

octo = Vehicle.preset("vehicle", "octo")
fields = octo.model_dump() | {"name": "Slow octorotor", "max_rotor_speed_hz": 95.0}
# What cannot hover within its limits, or lacks a field, is refused by name.
vehicle = Vehicle.parse(fields, "my vehicle")
config = ControllerConfig(vehicle=vehicle)
# The simulator needs the same vehicle; what it is in truth, zeta says.
log = fly(Scenario(vehicle=vehicle, seed=2).sampled(), Controller(config), 5.0)

print(f"{vehicle.name}: {vehicle.mass_kg:.1f} kg, {vehicle.n_rotors} rotors")
print(f"rotor speeds: {log.x[:, 12:].min():.0f} to {log.x[:, 12:].max():.0f} Hz")
print(f"least clearance: {log.d_T.min():.3f} m")
