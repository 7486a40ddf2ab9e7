# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The limit: an NMPC that knows the true state, and every force and torque of the moment.

At each step it takes from the simulation what the true vehicle's accelerations have beyond the
nominal model, whatever it comes from: mass, inertia, thrust, drag, wind, wall, and the gust that
acts now. That takes the place of an observer's estimate in the mode ``offset_free``; noise and
delay of the odometry do not touch it, and of the motors it knows the lag, as everybody does. What
it does not know is the future: gusts to come fade in its prediction as in that of ``offset_free``.
It has no margin but a constant one, which is tuned with the weights as that of every other NMPC.
It costs a step of ``offset_free`` and a look at the plant. Nothing that measures can do better
with this model, horizon and sampling time; what separates it from zero is what gusts change within
a sampling time and what limited rotors can do.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gtmr_model import N_ZETA, dynamics
from gtmr_model.dynamics import RATE, ROTORS, VELOCITY
from gtmr_nmpc import Controller, ControllerConfig, Solution
from gtmr_nmpc.controller import fastest_iteration
from gtmr_nmpc.iteration import Iteration
from gtmr_nmpc.margins import FixedMargin
from gtmr_nmpc.observer import BIAS, GUST, N_THETA, TORQUE, Estimate, InterpretedObserver
from gtmr_sim.simulation import Simulation
from gtmr_study.rivals.fixed_margin import FixedMarginParameters, weights
from gtmr_study.rivals.tuning import Tuned

Array = NDArray[np.float64]


class OracleParameters(FixedMarginParameters):
    """What the oracle is tuned by: margin and weights, as its neighbour that knows nothing."""

    margin_m: float = Field(0.003, ge=0.0005, le=0.05)
    """By how much every stage is tightened [m]."""
    position_scale: float = Field(10.0, ge=0.3, le=60.0)
    """Factor of the paper's weights on position, at the end of the horizon too [-]."""
    rotor_acceleration: float = Field(1e-6, ge=1e-8, le=1e-4)
    """Q_u [(Hz/s)^-2]."""


class Truth(InterpretedObserver):
    """An `Observer` that looks instead of estimating."""

    simulation: Simulation
    """The flight."""

    def update(self, x: Array, dt_s: float) -> Estimate:
        """Give the true state and the disturbances of the moment; both arguments are ignored."""
        scenario, plant = self.simulation.scenario, self.simulation.plant
        gust = self.simulation.gust_n
        # A copy of the plant moves on by one of its steps; the flight knows nothing of it.
        probe = copy.copy(plant)
        probe.advance(np.zeros(scenario.vehicle.n_rotors), gust, 1)
        moved = (probe.x - plant.x) / scenario.step_s
        between = 0.5 * (plant.x + probe.x)
        nominal = dynamics(between, moved[ROTORS], np.zeros(N_ZETA), np.zeros(3), scenario.vehicle)
        more = moved - nominal
        # Of the acceleration by a gust the true mass decides, of the prediction the nominal one.
        gust = gust / (1.0 + scenario.zeta_array[0])
        theta = np.zeros(N_THETA)
        theta[GUST] = gust
        theta[BIAS] = scenario.vehicle.mass_kg * more[VELOCITY] - gust
        theta[TORQUE] = np.array(scenario.vehicle.inertia_kg_m2) * more[RATE]
        self._x, self._theta = plant.x.copy(), theta
        return Estimate(plant.x.copy(), theta.copy())


class Seeing:
    """An iteration with another observer; another class too, so that no step in C has its own."""

    def __init__(self, iteration: Iteration, truth: Truth) -> None:
        self._iteration, self._truth = iteration, truth

    def __getattr__(self, name: str) -> Any:
        """Be the iteration in all else."""
        return getattr(self._iteration, name)

    def observer(self) -> Truth:
        """Give what looks."""
        return self._truth


class Oracle:
    """The controller of one flight."""

    def __init__(self, config: ControllerConfig, parameters: OracleParameters) -> None:
        cost = weights(config.weights, parameters.position_scale, parameters.rotor_acceleration)
        own = {"weights": cost, "margin": FixedMargin(margin_m=parameters.margin_m)}
        offset_free = config.offset_free.model_copy(update=own)
        self.config = config.model_copy(update={"offset_free": offset_free})
        self._truth = Truth(self.config)
        seeing: Any = Seeing(fastest_iteration(self.config), self._truth)
        self._controller = Controller(self.config, "offset_free", seeing)

    def see_truth(self, simulation: Simulation) -> None:
        """Take the flight to look at, before its first step."""
        self._truth.simulation = simulation

    def step(self, t: float, x: Any, now: float | None = None) -> Solution:
        """Decide at the time of the simulation, for a plan that is played from ``now`` [s]."""
        truth_s = self._truth.simulation.time_s
        begin_s = truth_s if now is None else max(now, truth_s)
        return self._controller.step(truth_s, self._truth.simulation.x, begin_s)


ORACLE = Tuned("oracle", OracleParameters, Oracle, constrained=True)
"""What knows everything but the future."""
