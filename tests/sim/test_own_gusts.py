# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Gusts and vehicle effects of one's own: registered or installed, named, never a file."""

import runpy
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from gtmr_codegen.library import CompileError
from gtmr_model import ConfigError, Helix, Tower, Vehicle
from gtmr_nmpc import Controller
from gtmr_sim import EFFECTS, GUSTS, Plant, Scenario, fly, plant
from gtmr_sim.gust import make_gust

EXAMPLE = Path(__file__).parents[2] / "examples" / "04_own_gust.py"
VEHICLE = Vehicle.paper()
START = Helix().initial_state(Tower(), VEHICLE)
POSITION = np.array([0.0, 1.35, 2.0])
SQUALL = {"kind": "squall", "parameters": {"start_s": 0.1, "rise_s": 0.1}}


@pytest.fixture(autouse=True)
def registries(monkeypatch):
    """What a test registers is gone after it."""
    for registry in (GUSTS, EFFECTS):
        monkeypatch.setattr(registry, "_registered", dict(registry._registered))


def test_the_example_registers_a_gust_that_flies_by_name():
    runpy.run_path(str(EXAMPLE))
    log = fly(Scenario.parse({"gust": SQUALL}, "scenario"), Controller(), 0.4)

    towards = -log.w_g[:, 0]
    np.testing.assert_allclose(towards[:5], 0.0, atol=1e-12)
    assert np.linalg.norm(log.w_g, axis=1).max() == pytest.approx(0.6, rel=1e-6)
    assert log.t[towards.argmax()] == pytest.approx(0.2)


def test_an_installed_package_brings_a_gust_to_the_command_line(gtmr, tmp_path, monkeypatch):
    (tmp_path / "breeze.py").write_text("def gust(scenario): return lambda t, p: [9.0, 0.0, 0.0]")
    described = tmp_path / "breeze-1.0.dist-info"
    described.mkdir()
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: breeze\nVersion: 1.0\n")
    (described / "entry_points.txt").write_text("[gtmr.gusts]\nbreeze = breeze:gust\n")
    monkeypatch.syspath_prepend(tmp_path)

    ended = gtmr("fly", "--gust", "breeze", "--duration", 0.1, "--out", tmp_path / "f.npz")

    assert ended.returncode == 0, ended.stderr
    np.testing.assert_allclose(np.load(tmp_path / "f.npz")["w_g"], [[0.6, 0.0, 0.0]] * 4)


@pytest.mark.parametrize("name", ["gale", "gale.py:Gust", "os:system"])
def test_an_unknown_name_is_refused_with_those_there_are(name):
    with pytest.raises(ConfigError, match=rf"gust.kind = '{name}': .*ou, dryden, sinusoid, worst"):
        Scenario.parse({"gust": {"kind": name}}, "scenario")
    with pytest.raises(ConfigError, match=rf"effects = .*'{name}'.*: .*registered or installed"):
        Scenario.parse({"effects": [name]}, "scenario")


@pytest.mark.parametrize(
    ("gust", "told"),
    [
        ({"kind": "squall"}, "missing a required argument: 'start_s'"),
        ({**SQUALL, "parameters": {"speed": 1.0}}, "squall"),
        ({"kind": "ou", "parameters": {"std": 1.0}}, "'ou', parameters: .*'std'"),
    ],
)
def test_parameters_that_a_gust_does_not_take_are_refused(gust, told):
    runpy.run_path(str(EXAMPLE))
    with pytest.raises(ConfigError, match=told):
        Scenario.parse({"gust": gust}, "scenario")


@pytest.mark.parametrize("force", [[np.nan, 0.0, 0.0], [1.0], 0.0])
def test_a_gust_that_gives_no_force_is_told(force):
    GUSTS.register("odd")(lambda scenario: lambda t, p: force)
    with pytest.raises(ValueError, match=r"gust 'odd' gave .* at 0.5 s: expected"):
        make_gust(Scenario(gust={"kind": "odd"}))(0.5, POSITION)


def test_a_taken_name_is_not_given_away():
    with pytest.raises(ValueError, match="'ou' is registered already"):
        GUSTS.register("ou")(lambda scenario: None)


def fly_on(effects, zeta=(0.0,) * 9):
    flown = Plant(VEHICLE, zeta, START, 1e-3, Tower(), effects)
    flown.advance(np.zeros(6), np.zeros(3), 100)
    return flown.x


def test_an_effects_force_acts_as_a_wind_bias_and_its_torque_turns():
    force, torque_nm = ca.DM([0.3, -0.2, 0.1]), 0.02
    blown = fly_on((lambda x, *_: (force, ca.DM.zeros(3)),))
    np.testing.assert_allclose(blown, fly_on((), (*[0.0] * 6, 0.3, -0.2, 0.1)), atol=1e-13)

    turned = fly_on((lambda x, *_: (ca.DM.zeros(3), ca.DM([0.0, 0.0, torque_nm])),))
    # Level and turning about one principal axis only: J_z omega_z' is the torque.
    grown = turned[11] - fly_on(())[11]
    assert grown == pytest.approx(0.1 * torque_nm / VEHICLE.inertia_kg_m2[2], rel=1e-6)


def test_effects_add_up_and_an_effect_of_nothing_changes_nothing():
    nothing, lift = (lambda x, *_, f=f: (ca.DM([0, 0, f]), ca.DM.zeros(3)) for f in (0.0, 0.1))
    np.testing.assert_array_equal(fly_on((nothing,)), fly_on(()))
    twice = fly_on((), (*[0.0] * 8, 0.2))
    np.testing.assert_allclose(fly_on((lift, nothing, lift)), twice, atol=1e-13)


def test_an_effect_with_branches_and_powers_compiles_to_what_it_says_bit_by_bit():
    runpy.run_path(str(EXAMPLE))

    def field(x, zeta, vehicle, tower):
        near = ca.if_else(x[0] < 1.4, ca.tanh(x[2]), ca.exp(-x[0]))
        return ca.vertcat(near, ca.atan2(x[1], x[0]), ca.log(x[2])), ca.sqrt(x[0]) * zeta[:3]

    step = plant._plant_step(VEHICLE, 1e-3, Tower(), (field, EFFECTS["suction"]))
    memory = np.concatenate((START, np.ones(6), np.full(9, 0.1), np.zeros(3), [np.inf]))
    expected = memory.copy()
    plant._interpreted(step, expected, 20)
    plant._compiled(step)(memory, 20)
    np.testing.assert_array_equal(memory, expected)


def test_an_effect_that_cannot_be_compiled_flies_interpreted(monkeypatch):
    said = []
    monkeypatch.setattr(plant, "warn_interpreted", said.append)
    flown = fly_on((lambda x, *_: (ca.vertcat(0, 0, ca.erf(x[2])), ca.DM.zeros(3)),))
    assert flown[8] > 0.0
    assert isinstance(said[0], CompileError)


def test_an_effect_of_the_wrong_shape_is_told():
    def odd(*_):
        return ca.DM.zeros(2), ca.DM.zeros(3)

    with pytest.raises(ValueError, match=r"effect odd: shapes \(2, 1\) and \(3, 1\)"):
        fly_on((odd,))


def test_an_effect_named_in_a_scenario_pulls_the_vehicle_closer():
    runpy.run_path(str(EXAMPLE))
    calm = {"gust": {"kind": "none"}}
    still, pulled = (
        fly(Scenario.parse(calm | {"effects": effects}, "scenario"), Controller(), 2.0).d_T.min()
        for effects in ([], ["suction"])
    )
    assert pulled < still - 1e-3


def test_only_coloured_noise_loads_scipy_linalg():
    check = "import sys, gtmr_sim; sys.exit('scipy.linalg' in sys.modules)"
    subprocess.run([sys.executable, "-c", check], check=True)
