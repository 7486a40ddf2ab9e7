# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Print the slowest modes of the closed loop for several attitude weights (docs/level-flight.md).

Run with ``python bench/closed_loop_modes.py``; takes about a minute.
"""

from gtmr_nmpc import ControllerConfig, Weights
from gtmr_nmpc.reference.eigenmodes import closed_loop_modes

CASES = [(0.0, 0.0, 0.0), (0.1, 1.0, 0.1), (5.0, 5.0, 0.5), (50.0, 50.0, 5.0)]
"""Weights on roll and pitch, yaw, body rate."""

print(f"{'roll_pitch':>10} {'yaw':>6} {'rate':>6}   {'slowest':>10}   largest |eigenvalues|")
for roll_pitch, yaw, rate in CASES:
    weights = Weights(roll_pitch=roll_pitch, yaw=yaw, rate=rate)
    modes = closed_loop_modes(ControllerConfig(weights=weights))
    largest = " ".join(f"{abs(value):.6f}" for value in modes.eigenvalues[:5])
    print(f"{roll_pitch:10g} {yaw:6g} {rate:6g}   {modes.slowest_s:8.2f} s   {largest}")
