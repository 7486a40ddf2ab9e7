# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The plant with mismatch and gusts, and flights without ROS."""

from gtmr_sim.flying.flight import fly
from gtmr_sim.flying.log import FlightFileError, FlightLog
from gtmr_sim.flying.stepwise import FlightError, StepController
from gtmr_sim.plant import Plant
from gtmr_sim.registry import EFFECTS, GUSTS
from gtmr_sim.scenario import GUST_KINDS, GustConfig, Scenario
from gtmr_sim.simulation import Simulation
from gtmr_sim.worlds.world import NamedWorld, World

__all__ = [
    "EFFECTS",
    "GUSTS",
    "GUST_KINDS",
    "FlightError",
    "FlightFileError",
    "FlightLog",
    "GustConfig",
    "NamedWorld",
    "Plant",
    "Scenario",
    "Simulation",
    "StepController",
    "World",
    "fly",
]
