# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""The controller: nominal and sensitivity-based robust NMPC; only `node` knows ROS."""

from gtmr_nmpc.config import MODES, ControllerConfig, Mode, Weights
from gtmr_nmpc.controller import Controller
from gtmr_nmpc.solution import Solution, Timing

__all__ = ["MODES", "Controller", "ControllerConfig", "Mode", "Solution", "Timing", "Weights"]
