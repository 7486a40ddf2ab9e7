# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A world: what a vehicle meets beyond eq. (3), in one file."""

from __future__ import annotations

from typing import Annotated

from gtmr_model import YamlModel
from gtmr_model.yaml_model import named
from gtmr_sim.worlds.motors import Motors
from gtmr_sim.worlds.sensor import Odometry
from gtmr_sim.worlds.wall import Wall
from gtmr_sim.worlds.wind import Wind


class World(YamlModel):
    """The effects of a world; what is left out is not there. With none it is the paper's."""

    odometry: Odometry = Odometry()
    """How the state is measured."""
    motors: Motors | None = None
    """How rotors follow their commands; left out: they take any acceleration within limits."""
    wind: Wind | None = None
    """Wind as a velocity field; left out: it is the force w_b of zeta."""
    wall: Wall | None = None
    """What the tower's wall does to rotors."""

    @property
    def in_plant(self) -> World:
        """What of it acts within the plant's steps, and is compiled into it."""
        wind = self.wind
        if wind is not None:
            wind = Wind(blade_drag_n_s_per_m_hz=wind.blade_drag_n_s_per_m_hz)
        motors = self.motors
        if motors is not None:
            motors = Motors(lag_s=motors.lag_s)
        return World(motors=motors, wind=wind, wall=self.wall)

    @property
    def lag_s(self) -> float:
        """From a command to what the rotors do [s]."""
        return 0.0 if self.motors is None else self.motors.lag_s + self.motors.transport_s


PAPER = World()
"""Eq. (3) alone: odometry is the truth, at once."""


NamedWorld = Annotated[World, named("world", World.load)]
"""A world in a configuration: its fields, a preset's name, or the path of a YAML file."""
