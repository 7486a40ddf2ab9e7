# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The demo flies what it is told: the same flight as in one process."""

import json

import numpy as np
import pytest
import yaml
from support.command_line import gtmr_process

from gtmr_model import Vehicle
from gtmr_monitor import read_flight
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import Scenario, fly

ZETA = (0.02, 0.0, 0.0, 0.0, -0.03, 0.0, 0.1, -0.2, 0.05)


def test_the_demo_flies_seed_gusts_mismatch_vehicle_and_controller_that_it_is_given(tmp_path):
    vehicle = Vehicle.paper().model_copy(update={"name": "mine", "mass_kg": 2.4})
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(vehicle.model_dump(mode="json")))
    fields = {
        "tower": {"radius_m": 1.5, "min_clearance_m": 0.25},
        "helix": {"offset_m": 0.45, "speed_m_s": 0.4},
        "uncertainty": {"gust_n": 0.5},
    }
    (tmp_path / "tuned.yaml").write_text(yaml.safe_dump(fields))
    run = gtmr_process(
        *("demo", "--duration", 1, "--modes", "robust", "--out", "out", "--json", "demo.json"),
        *("--seed", 4, "--gust", "dryden", "--zeta", *ZETA),
        *("--vehicle", "mine.yaml", "--controller", "tuned.yaml"),
        cwd=tmp_path,
    )
    assert run.returncode == 0, run.stderr
    assert "Flying mine around a tower of 3 m diameter, 0.45 m from its surface" in " ".join(
        run.stdout.split()
    )
    config = ControllerConfig.parse(fields, "tuned").model_copy(update={"vehicle": vehicle})
    scenario = Scenario(
        vehicle=vehicle,
        tower=config.tower,
        helix=config.helix,
        uncertainty=config.uncertainty,
        zeta=ZETA,
        gust={"kind": "dryden"},
        seed=4,
    )
    log = fly(scenario, Controller(config), 1.0)
    flight = read_flight(tmp_path / "out" / "robust" / "bag")
    assert flight.vehicle == vehicle
    assert flight.tower == config.tower
    for t, position in zip(log.t, log.x[:, :3], strict=True):
        at = int(np.abs(flight.t - t).argmin())
        assert flight.t[at] == pytest.approx(t, abs=1e-6)
        np.testing.assert_allclose(flight.p[at], position, atol=1e-9)
    told = json.loads((tmp_path / "demo.json").read_text())["modes"]["robust"]
    for key in ("radial_rms_m", "tracking_rms_m"):
        # The bag has the state at the end as well.
        assert told[key] == pytest.approx(log.summary()[key], abs=3e-3)
