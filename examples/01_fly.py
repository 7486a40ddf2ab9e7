# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""One flight: a simulated vehicle, a controller, and how close it came to the tower."""

from gtmr_nmpc import Controller
from gtmr_sim import Scenario, fly

DURATION_S = 5.0

# The true vehicle differs from the controller's model in nine numbers, drawn by the seed.
scenario = Scenario(seed=7).sampled()
log = fly(scenario, Controller(mode="robust"), DURATION_S)

print(f"true mismatch: {[round(value, 3) for value in scenario.zeta]}")
print(f"steps: {len(log.t)}, solved in {log.solve_ms.mean():.2f} ms on average")
print(f"least clearance: {log.d_T.min():.3f} m, allowed: {scenario.tower.min_clearance_m} m")
