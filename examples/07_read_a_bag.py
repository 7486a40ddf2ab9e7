# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Read a bag, without ROS: how close the flight came, and what its margins were for.

Another bag than the sample: python examples/07_read_a_bag.py BAG
"""

import sys
from pathlib import Path

import numpy as np

from gtmr_model import CHANNELS
from gtmr_monitor import read_flight

SAMPLE = Path(__file__).parents[1] / "bags" / "sample"

# A folder of rosbag2 or one MCAP file. Times are in seconds since the first odometry.
flight = read_flight(sys.argv[1] if len(sys.argv) > 1 else SAMPLE)
print(f"{flight.name}: {flight.mode}, {flight.duration_s:.1f} s, {flight.t.size} states")
for note in flight.notes:
    print(f"note: {note}")

# flight.clearance is d_T [m], flight.residual is s = d_min - d_T [m]: above zero is a violation.
closest = int(np.argmin(flight.clearance))
print(f"least clearance {flight.clearance[closest]:.3f} m at {flight.t[closest]:.2f} s")
print(f"allowed {flight.tower.min_clearance_m:.2f} m, violated: {(flight.residual > 0.0).any()}")

# Margins are by controller step, stage of the horizon and channel of zeta; the last stage is the
# most uncertain one.
margins = flight.margins
if margins.t.size:
    parts = dict(zip(CHANNELS, margins.by_channel[:, -1].T, strict=True))
    parts |= {"eps_s": margins.eps_s[:, -1], "gust": margins.alpha_g[:, -1]}
    parts["total"] = margins.total[:, -1]
    print(f"\n{'margin at the last stage [mm]':30}{'mean':>8}{'max':>8}")
    for name, margin_m in parts.items():
        print(f"{name:30}{1e3 * margin_m.mean():8.2f}{1e3 * margin_m.max():8.2f}")
