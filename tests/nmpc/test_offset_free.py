# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Flights in the mode offset_free: at the reference, whatever the vehicle and the gusts are."""

import numpy as np
import pytest

from gtmr_model import Vehicle
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.observer import BIAS, GUST, InterpretedObserver
from gtmr_sim import Scenario, Simulation, fly

NEAR = ControllerConfig(helix={"offset_m": 0.22})
"""2 cm beside the least clearance."""


def rms_m(log, d_ref_m, after_s=5.0):
    return float(np.sqrt(np.mean((log.d_T - d_ref_m)[log.t >= after_s] ** 2)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["worst-case", "ou"])
def test_two_centimetres_from_the_limit_no_vertex_violates(kind):
    controller = Controller(NEAR, "offset_free")
    for k, zeta in enumerate(NEAR.uncertainty.vertices()[3::101]):
        controller.reset()
        scenario = Scenario(
            helix=NEAR.helix, zeta=tuple(zeta), gust={"kind": kind}, seed=k, guard="hold"
        )
        log = fly(scenario, controller, 10.0)
        assert log.d_T.min() > 0.2
        assert rms_m(log, 0.22) < 2e-3
        assert log.failed_steps == 0


@pytest.mark.slow
def test_what_the_paper_flies_past_is_flown_at():
    scenario = Scenario(seed=1, guard="hold").sampled()
    off = {
        mode: rms_m(fly(scenario, Controller(mode=mode), 15.0), 0.35)
        for mode in ("nominal", "robust", "offset_free")
    }
    assert off["offset_free"] < 2e-3
    assert min(off["nominal"], off["robust"]) > 20.0 * off["offset_free"]


def test_a_mass_that_changes_in_flight_is_corrected():
    config = ControllerConfig()
    controller = Controller(config, "offset_free")
    scenario = Scenario(gust={"kind": "none"}, guard="hold")
    simulation, off = Simulation(scenario, 0.025), []
    for k in range(320):
        if k == 160:
            heavier = (0.2 / config.vehicle.mass_kg, *(0.0,) * 8)
            simulation.reconfigure(scenario.model_copy(update={"zeta": heavier}))
        t = simulation.time_s
        simulation.command(t, controller.step(t, simulation.x).u_plan)
        reference = config.helix.at(t, config.tower).position[0]
        off.append(simulation.x[:3] - reference)
        simulation.advance(0.025)
    off = np.abs(np.array(off))
    # It sinks by centimetres, and is back within a second; the tower comes no closer.
    assert off[160:, 2].max() < 0.05
    assert off[200:, 2].max() < 2e-3
    assert off[160:, :2].max() < 2e-3


def test_rotors_at_their_limits_wind_nothing_up():
    # So much wind that rotors which can hardly speed up stand at their limit.
    limits = {"max_rotor_speed_hz": 66.0, "max_rotor_acceleration_hz_s": 30.0}
    config = ControllerConfig(vehicle=Vehicle.paper().model_copy(update=limits))
    controller, observer = Controller(config, "offset_free"), InterpretedObserver(config)
    scenario = Scenario(
        vehicle=config.vehicle,
        zeta=(0.05, 0, 0, 0, -0.05, 0, 0.8, 0.0, -0.2),
        gust={"kind": "none"},
        guard="hold",
    )
    simulation, at_limit = Simulation(scenario, 0.025), 0
    for _ in range(200):
        t = simulation.time_s
        theta = observer.update(simulation.x, 0.025).theta
        solution = controller.step(t, simulation.x)
        at_limit += bool((solution.x_plan[:, 12:] > 65.99).any())
        simulation.command(t, solution.u_plan)
        simulation.advance(0.025)
    assert at_limit > 50
    # What is estimated is what acts, not what could not be done about it.
    weight = 9.81 * config.vehicle.mass_kg
    assert (theta[BIAS] + theta[GUST])[0] == pytest.approx(0.8, abs=0.15)
    assert (theta[BIAS] + theta[GUST])[2] == pytest.approx(-0.2 - 0.1 * weight, abs=0.3)


def test_a_switch_in_flight_computes_nothing_anew(monkeypatch):
    """What takes long was computed before: a node hands over its parameters with the new mode."""
    controller = Controller(ControllerConfig(), "offset_free")
    controller.mode = "nominal"
    monkeypatch.setattr("gtmr_nmpc.controller.deviations", lambda _: pytest.fail("computed again"))
    controller.mode = "offset_free"
    controller.reconfigure(ControllerConfig())
    assert controller.mode == "offset_free"
