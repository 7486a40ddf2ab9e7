# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Both controllers on the same flight: same mismatch, same gusts, same wind."""

from gtmr_nmpc import MODES, Controller
from gtmr_sim import Scenario, fly

# A steady wind of 0.6 N and 0.4 N along x and y, unknown to the controllers.
scenario = Scenario(zeta=(0.0,) * 6 + (0.6, 0.4, 0.0), seed=1)

for mode in MODES:
    log = fly(scenario, Controller(mode=mode), 10.0)
    margin_m = log.alpha_p[:, -1] + log.alpha_g[:, -1]
    print(
        f"{mode}: least clearance {log.d_T.min():.3f} m, "
        f"margin at the end of the horizon {margin_m.mean():.3f} m on average"
    )
