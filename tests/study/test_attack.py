# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import json

import numpy as np
import pytest

from gtmr_nmpc import ControllerConfig
from gtmr_sim import World
from gtmr_study.attack import search
from gtmr_study.attack.search import attack
from gtmr_study.attack.space import LENGTH, Target, random_choice, scenario_of, vertex_choice

pytestmark = pytest.mark.slow

TARGET = Target(mode="nominal", controller=ControllerConfig(), world=World(), duration_s=2.0)
FLIGHTS = 80


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """One search on two workers, and what it wrote."""
    folder = tmp_path_factory.mktemp("attack")
    return attack(TARGET, FLIGHTS, 3, folder, 2), folder


def flights_of(folder):
    return (folder / search.FLIGHTS).read_text().splitlines()


def test_a_seed_finds_the_same_on_any_number_of_workers(found, tmp_path):
    result, folder = found
    again = attack(TARGET, FLIGHTS, 3, tmp_path / "one", 1)
    assert flights_of(folder) == flights_of(tmp_path / "one")
    assert again["min_clearance_m"] == result["min_clearance_m"]
    other = attack(TARGET, 8, 4, tmp_path / "other", 1)
    assert other["min_clearance_m"] != result["min_clearance_m"]


def test_a_search_that_was_killed_goes_on_and_flies_nothing_twice(found, tmp_path, monkeypatch):
    _, folder = found
    lines = flights_of(folder)
    # In the second generation of CMA-ES, and within a line.
    (tmp_path / search.FLIGHTS).write_text("\n".join([*lines[:58], lines[58][:9]]))
    flown = []
    fly = search._fly

    def counted(client, target, numbered, seed):
        flown.extend(number for number, _ in numbered)
        return fly(client, target, numbered, seed)

    monkeypatch.setattr(search, "_fly", counted)
    attack(TARGET, FLIGHTS, 3, tmp_path, 1)
    assert flights_of(tmp_path) == lines
    assert flown == list(range(57, FLIGHTS))


def test_the_worst_are_the_least_and_fly_again_to_the_last_digit(found, gtmr, tmp_path):
    result, folder = found
    values = [json.loads(line)["min_clearance_m"] for line in flights_of(folder)[1:]]
    assert len(values) == FLIGHTS
    assert [w["min_clearance_m"] for w in result["worst"]] == sorted(values)[:10]
    assert result["violations"] == sum(value < 0.2 for value in values)
    written = tmp_path / "again.json"
    for worst in result["worst"][:2]:
        ended = gtmr("fly", "--scenario", worst["scenario"], "--json", written)
        assert ended.returncode == 0, ended.stderr
        told = json.loads(written.read_text())
        assert told["min_clearance_any_time_m"] == worst["min_clearance_m"]
        written.unlink()


def test_the_third_mode_flies_again_to_the_last_digit_too(gtmr, tmp_path):
    # Workers multiply matrices in one thread, this process in as many as it has.
    target = TARGET.model_copy(update={"mode": "offset_free"})
    result = attack(target, 8, 3, tmp_path / "search", 1)
    for k, worst in enumerate(result["worst"]):
        written = tmp_path / f"{k}.json"
        gtmr("fly", "--scenario", worst["scenario"], "--json", written)
        told = json.loads(written.read_text())
        assert told["min_clearance_any_time_m"] == worst["min_clearance_m"]


def test_a_damaged_search_is_refused_in_one_line(found, tmp_path, refused):
    _, folder = found
    lines = flights_of(folder)
    damaged = ("", "no json\n", "\n".join([*lines[:5], "{}", *lines[5:], ""]))
    for k, text in enumerate(damaged):
        (tmp_path / str(k)).mkdir()
        (tmp_path / str(k) / search.FLIGHTS).write_text(text)
        told = refused("attack", "--flights", 8, "--out", tmp_path / str(k))
        assert "is damaged" in told
        assert (tmp_path / str(k) / search.FLIGHTS).read_text() == text


def test_another_search_and_other_files_are_refused_and_left_alone(found, tmp_path, refused):
    _, folder = found
    before = flights_of(folder)
    run = refused("attack", "--mode", "nominal", "--flights", 8, "--seed", 9, "--out", folder)
    assert "holds another search" in run
    run = refused("attack", "--mode", "nominal", "--flights", 2 * FLIGHTS, "--out", folder)
    assert "holds another search" in run
    (tmp_path / "mine.txt").write_text("mine")
    run = refused("attack", "--flights", 8, "--out", tmp_path)
    assert "mine.txt" in run
    assert flights_of(folder) == before
    assert "--mode" in refused("attack", "--mode", "bold", "--out", tmp_path / "new")
    for more in (["--sample"], ["--seed", 3], ["--gust", "none"], ["--duration", 9]):
        assert "--scenario" in refused("fly", "--scenario", folder / "worst-01.yaml", *more)


def test_what_is_chosen_is_within_what_the_world_states():
    rng = np.random.default_rng(0)
    field = Target(
        mode="offset_free",
        controller=ControllerConfig.load("controller", "field"),
        world=World.load("world", "field"),
    )
    box = field.controller.uncertainty
    for u in (*(rng.uniform(size=LENGTH) for _ in range(20)), random_choice(rng)):
        scenario = scenario_of(field, u, 1)
        box.require_inside(scenario.zeta)
        assert np.abs(scenario.gust.sequence).max() <= 1.0
        odometry, stated = scenario.world.odometry, field.world.odometry
        assert odometry.delay_s == stated.delay_s
        assert odometry.jitter_s <= stated.jitter_s
        assert scenario.start_offset_m[0] >= 0.0
        assert np.abs(scenario.start_offset_m).max() <= 0.05
    vertices = {scenario_of(TARGET, vertex_choice(v, True, rng), 0).zeta for v in range(512)}
    assert len(vertices) == 512


def test_the_worst_gusts_bring_the_nominal_mode_closer_than_chance_does():
    rng = np.random.default_rng(1)
    target = TARGET.model_copy(update={"duration_s": 8.0})
    worst = [vertex_choice(v, False, rng) for v in range(0, 512, 64)]
    mild = rng.uniform(0.45, 0.55, size=(8, LENGTH))
    mild[:, 10] = 1.0
    least = [min(search.fly_choices(target, list(u), [0] * 8)) for u in (worst, mild)]
    assert least[0] < 0.2 < least[1]
