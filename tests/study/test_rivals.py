# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Every rival flies: calmly where nothing disturbs it, sanely where much does."""

import numpy as np
import pytest

from gtmr_model import ConfigError, Helix, Vehicle
from gtmr_nmpc import ControllerConfig
from gtmr_sim import Scenario, World, fly
from gtmr_study.campaign.study import controller_for
from gtmr_study.rivals import tuning
from gtmr_study.rivals.catalogue import RIVALS
from gtmr_study.rivals.feedback.lqr import LQR
from gtmr_study.rivals.fixed_margin import FIXED_MARGIN, FixedMarginParameters
from gtmr_study.rivals.tuning import SEED, Found, Tuned, Tuning, as_yaml, cost, search

NAMES = [
    pytest.param(name, marks=pytest.mark.slow if rival.trials < 1.0 else ())
    for name, rival in RIVALS.items()
]
FEEDBACKS = ("lqr", "pid", "indi")
BOUNDS = FixedMarginParameters.logarithmic_ranges()


def flown(name, world="paper", duration_s=7.0, vehicle=None, tuned=True, **others):
    """Fly a rival as the arena does, with the problem that is told of the world."""
    named = World.preset("world", world)
    config = ControllerConfig.preset("controller", controller_for(named))
    own = {"helix": Helix(offset_m=0.3)}
    if vehicle is not None:
        own["vehicle"] = Vehicle.preset("vehicle", vehicle)
    config = config.model_copy(update=own)
    scenario = Scenario(world=named, guard="hold", seed=SEED + 1, **own, **others)
    if "gust" not in others:
        scenario = scenario.sampled()
    make = RIVALS[name].make
    made = make(config, scenario) if tuned else make.build(config, make.parameters())
    return fly(scenario, made, duration_s)


def radial_rms_m(log):
    return float(np.sqrt(np.mean((log.d_T - 0.3)[log.t >= 5.0] ** 2)))


@pytest.mark.parametrize("name", NAMES)
def test_it_flies_calmly_where_nothing_disturbs_it(name):
    log = flown(name, gust={"kind": "none"})

    assert radial_rms_m(log) < 0.02
    assert np.abs(log.u[log.t >= 5.0]).max() < 20.0


@pytest.mark.slow
@pytest.mark.parametrize("world", ["field", "hard"])
@pytest.mark.parametrize("name", NAMES)
def test_it_stays_sane_where_much_disturbs_it(name, world):
    log = flown(name, world)

    assert np.abs(log.d_T - 0.3).max() < 0.2
    assert np.abs(log.x[:, 3:5]).max() < 0.3
    assert not log.failed.any()


@pytest.mark.parametrize("name", FEEDBACKS)
def test_a_vehicle_that_must_tilt_flies_too(name):
    east_n = (0.0,) * 6 + (0.3, 0.0, 0.0)
    # What is tuned is tuned for rotors that push into any direction.
    log = flown(name, vehicle="quad", tuned=False, zeta=east_n, gust={"kind": "none"})

    assert radial_rms_m(log) < 0.02
    assert np.abs(log.x[-1, 3:5]).max() > 0.005, "against the wind it leans"


@pytest.mark.parametrize("name", FEEDBACKS)
def test_a_mismatch_leaves_no_lasting_error(name):
    zeta = (0.08, 0.0, 0.0, 0.0, -0.08, 0.0, 0.5, 0.3, 0.0)
    log = flown(name, duration_s=10.0, tuned=False, zeta=zeta, gust={"kind": "none"})

    assert np.linalg.norm(log.tracking_error_m[-1]) < 0.015


def test_the_world_decides_which_numbers_fly(monkeypatch):
    found = {
        name: Found(cost_m=0.1, flights=1, parameters={"margin_m": margin})
        for name, margin in (("paper", 0.01), ("field", 0.02), ("hard", 0.03))
    }
    monkeypatch.setattr(tuning, "_tuning", lambda _: Tuning(seed=SEED, worlds=found))
    own = World(odometry={"position_std_m": 0.5})
    worlds = [*(World.preset("world", name) for name in found), own]

    margins = [FIXED_MARGIN.found(world).margin_m for world in worlds]
    assert margins == [0.01, 0.02, 0.03, 0.01]


def test_numbers_beyond_what_is_searched_are_refused(monkeypatch):
    found = {"paper": Found(cost_m=0.1, flights=1, parameters={"margin_m": 2.0})}
    monkeypatch.setattr(tuning, "_tuning", lambda _: Tuning(seed=SEED, worlds=found))

    with pytest.raises(ConfigError, match=r"fixed_margin.yaml, paper: margin_m = 2.0"):
        FIXED_MARGIN.found(World())


@pytest.mark.parametrize("rival", [r.make for r in RIVALS.values() if isinstance(r.make, Tuned)])
def test_its_file_has_what_a_search_found_for_every_world(rival):
    there = Tuning.preset("rivals", rival.name)

    assert set(there.worlds) == set(tuning.WORLDS)
    for world, found in there.worlds.items():
        assert set(found.parameters) == set(rival.parameters.model_fields)
        assert rival.found(World.preset("world", world)).model_dump() == found.parameters
        assert found.cost_m < 0.2, "no flight that it was tuned on failed"
    assert Tuning.parse(tuning.yaml.safe_load(as_yaml(rival, there)), "written") == there


def test_a_search_finds_the_least_cost_and_finds_it_again(monkeypatch):
    tried = []

    def bowl(build, world, trials, constrained):
        parameters = build(None)
        tried.append(parameters)
        off = np.log(list(parameters.model_dump().values())) - BOUNDS.mean(axis=1)
        return float(off @ off)

    rival = Tuned("bowl", FixedMarginParameters, lambda _, parameters: parameters)
    monkeypatch.setattr(tuning, "cost", bowl)
    first, again = (search(rival, "paper", 65, 2) for _ in range(2))

    assert first == again
    assert first.flights == 65 * 2
    assert first.cost_m < 0.1 * bowl(lambda _: tried[0], "paper", 2, False)
    assert tried[0] == FixedMarginParameters()


def test_a_cost_is_that_of_the_same_flights_again_and_a_crash_is_dear():
    class Falls:
        def __init__(self, config):
            self.n = config.vehicle.n_rotors

        def step(self, t, x):
            return np.full(self.n, -50.0)

    class Raises(Falls):
        def step(self, t, x):
            raise RuntimeError

    def lqr(config):
        return LQR.build(config, LQR.parameters())

    assert cost(lqr, "paper", 1) == cost(lqr, "paper", 1) < 0.02
    assert cost(Falls, "paper", 1) > 0.5
    assert cost(Raises, "paper", 1) == tuning.FAILED_M
