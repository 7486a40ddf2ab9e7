# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A search begins with the shipped presets, goes on where it was, and ends in a scenario."""

import json
import math
from contextlib import nullcontext

import pytest

from gtmr_study.calibration import BEST, PRESETS, calibrate
from gtmr_study.campaign import cluster
from gtmr_study.campaign.study import Study
from gtmr_study.paper.unreported import UNREPORTED, values_of, with_values


@pytest.mark.parametrize("preset", PRESETS)
def test_a_search_can_begin_with_a_shipped_preset(preset):
    study = Study.load("scenario", preset)
    values = values_of(study)

    assert with_values(values, Study(trials=study.trials)) == study
    assert set(values) == set(UNREPORTED)
    for name, known in UNREPORTED.items():
        if known.searched is not None:
            low, high = known.searched
            assert low <= values[name] <= high
            assert known.step is None or (values[name] - low) % known.step == 0.0


@pytest.fixture(scope="module")
def one_worker():
    with cluster.local_threads(1) as client:
        yield client


@pytest.fixture
def cheap(one_worker, monkeypatch):
    """Search only what is not compiled in, on a worker that is started once."""
    monkeypatch.setattr(cluster, "local_threads", lambda count: nullcontext(one_worker))
    kept = ("rotor_acceleration_weight", "gust_std_n", "eps_s_m")
    for name in set(UNREPORTED) - set(kept):
        monkeypatch.delitem(UNREPORTED, name)


@pytest.mark.slow
def test_a_search_that_was_killed_goes_on_as_if_it_had_not_been(cheap, tmp_path, monkeypatch):
    base = Study(trials=1, duration_s=0.3, seed=4)
    whole = calibrate(base, "both", 4, tmp_path / "whole", 1)

    fly_on = cluster.fly_on
    left = 1

    def killed(client, study, flights):
        nonlocal left
        if left == 0:
            raise KeyboardInterrupt
        left -= 1
        return fly_on(client, study, flights)

    # In the second set, a preset, and then in the fourth.
    with monkeypatch.context() as patch:
        patch.setattr(cluster, "fly_on", killed)
        with pytest.raises(KeyboardInterrupt):
            calibrate(base, "both", 4, tmp_path / "part", 1)
        left = 2
        with pytest.raises(KeyboardInterrupt):
            calibrate(base, "both", 4, tmp_path / "part", 1)
    part = calibrate(base, "both", 4, tmp_path / "part", 1)

    for key in ("sets", "parameters", "distance", "presets"):
        assert part[key] == whole[key]
    assert part["sets"] == 4
    assert set(part["deviations"]) == {"nominal", "robust"}
    assert (tmp_path / "part" / BEST).read_text() == (tmp_path / "whole" / BEST).read_text()


@pytest.mark.slow
@pytest.mark.parametrize("target", ["nominal", "both"])
def test_the_best_set_is_told_and_kept_as_a_scenario(target, cheap, tmp_path, gtmr):
    options = ("--target", target, "--trials", 1, "--duration", 0.3, "--workers", 1, "--seed", 5)

    ended = gtmr(
        "calibrate", *options, "--sets", 3, "--out", tmp_path / "s", "--json", tmp_path / "s.json"
    )

    assert ended.returncode == 0, ended.stderr
    result = json.loads((tmp_path / "s.json").read_text())
    assert "Distance of the best of 3 sets" in ended.stdout
    assert f"{result['distance']:.3f}" in ended.stdout
    assert f"gtmr reproduce --scenario {tmp_path / 's' / BEST}" in ended.stdout
    assert set(result["presets"]) == set(PRESETS)
    assert result["distance"] <= min(result["presets"].values())
    best = Study.load("scenario", str(tmp_path / "s" / BEST))
    assert (best.trials, best.duration_s, best.seed) == (500, 0.3, 5)
    assert best.modes == ("nominal", "robust")
    values = values_of(best)
    for name, value in result["parameters"].items():
        assert values[name] == pytest.approx(value)


def test_a_set_whose_flights_raise_is_not_the_best(cheap, tmp_path, monkeypatch):
    base = Study(trials=1, duration_s=0.3, seed=4)
    fly_on = cluster.fly_on
    calls = []

    def raising(client, study, flights):
        calls.append(study)
        for rows in fly_on(client, study, flights):
            # The first set, a preset, loses a trial.
            yield [row | {"status": "error"} for row in rows] if len(calls) == 1 else rows

    monkeypatch.setattr(cluster, "fly_on", raising)

    result = calibrate(base, "nominal", 2, tmp_path / "s", 1)

    assert result["presets"]["paper"] == math.inf
    assert result["distance"] == result["presets"]["paper-closest"] < math.inf


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--target", "robust"), "--target = 'robust': allowed is nominal, both"),
        (("--sets", "0"), "--sets"),
        (("--duration", "0"), "duration_s = 0.0"),
        (("--seed", "-1"), "seed = -1"),
    ],
)
def test_a_search_refuses_bad_input(arguments, said, tmp_path, refused):
    assert said in refused("calibrate", "--out", tmp_path / "s", *arguments)
    assert not (tmp_path / "s").exists()


def test_a_search_leaves_other_folders_alone(cheap, tmp_path, refused):
    calibrate(Study(trials=1, duration_s=0.3), "nominal", 1, tmp_path / "s", 1)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")

    assert "holds another search" in refused("calibrate", "--out", tmp_path / "s")
    assert "thesis.txt" in refused("calibrate", "--out", tmp_path / "other")
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["thesis.txt"]
