# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""The plant with mismatch and gusts, and flights without ROS."""

from gtmr_sim.flight import FlightLog, fly
from gtmr_sim.plant import Plant
from gtmr_sim.scenario import GUST_KINDS, GustConfig, GustKind, Scenario
from gtmr_sim.simulation import Simulation

__all__ = [
    "GUST_KINDS",
    "FlightLog",
    "GustConfig",
    "GustKind",
    "Plant",
    "Scenario",
    "Simulation",
    "fly",
]
