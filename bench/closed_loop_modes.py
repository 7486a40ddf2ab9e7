# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""Print the slowest modes of the closed loop for several attitude weights (docs/level-flight.md).

Run with ``python bench/closed_loop_modes.py``; takes about a minute.
"""

from gtmr_nmpc import ControllerConfig, Weights
from gtmr_study.modes import closed_loop_modes

CASES = [(0.0, 0.0, 0.0), (0.1, 1.0, 0.1), (5.0, 5.0, 0.5), (50.0, 50.0, 5.0)]
"""Weights on roll and pitch, yaw, body rate."""

print(f"{'roll_pitch':>10} {'yaw':>6} {'rate':>6}   {'slowest':>10}   largest |eigenvalues|")
for roll_pitch, yaw, rate in CASES:
    weights = Weights(roll_pitch=roll_pitch, yaw=yaw, rate=rate)
    modes = closed_loop_modes(ControllerConfig(weights=weights))
    largest = " ".join(f"{abs(value):.6f}" for value in modes.eigenvalues[:5])
    print(f"{roll_pitch:10g} {yaw:6g} {rate:6g}   {modes.slowest_s:8.2f} s   {largest}")
