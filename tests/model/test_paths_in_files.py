# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Files that name further files: relative to themselves, wherever the process runs."""

from pathlib import Path

import pytest

from gtmr_model import ConfigError, Vehicle
from gtmr_model.yaml_model import presets_of
from gtmr_nmpc import ControllerConfig
from gtmr_study.campaign.study import Study


@pytest.fixture
def files(tmp_path):
    """A study in one folder, its controller and world in another, and a vehicle in a third."""
    for name in ("studies", "parts/vehicles", "elsewhere"):
        (tmp_path / name).mkdir(parents=True)
    text = Path(presets_of("vehicle")["paper"]).read_text(encoding="utf-8")
    light = text.replace("mass_kg: 2.57", "mass_kg: 2.5")
    assert light != text
    (tmp_path / "parts/vehicles/light.yaml").write_text(light)
    (tmp_path / "parts/mine.yaml").write_text("vehicle: vehicles/light.yaml\n")
    (tmp_path / "parts/late.yaml").write_text("odometry: {delay_s: 0.01}\n")
    (tmp_path / "studies/study.yaml").write_text(
        "controller: ../parts/mine.yaml\nworld: ../parts/late.yaml\n"
    )
    return tmp_path


@pytest.mark.parametrize("at", [".", "studies", "elsewhere"])
def test_paths_in_a_file_are_relative_to_it(at, files, monkeypatch):
    monkeypatch.chdir(files / at)
    study = Study.load("scenario", str(files / "studies/study.yaml"))
    assert study.controller.vehicle.mass_kg == 2.5
    assert study.world.odometry.delay_s == 0.01


def test_a_relative_path_to_a_file_counts_from_where_the_process_runs(files, monkeypatch):
    monkeypatch.chdir(files / "elsewhere")
    config = ControllerConfig.load("controller", "../parts/mine.yaml")
    assert config.vehicle.mass_kg == 2.5


def test_an_absolute_path_and_a_presets_name_stay_what_they_are(files):
    path = files / "studies/study.yaml"
    path.write_text(f"controller: {{vehicle: {files / 'parts/vehicles/light.yaml'}}}\n")
    assert Study.from_yaml(path).controller.vehicle.mass_kg == 2.5
    path.write_text("controller: {vehicle: octo}\n")
    assert Study.from_yaml(path).controller.vehicle == Vehicle.preset("vehicle", "octo")


def test_a_file_that_is_not_beside_it_is_named_with_its_folder(files, monkeypatch):
    # It is where the process runs, which does not count.
    monkeypatch.chdir(files / "parts/vehicles")
    (files / "parts/mine.yaml").write_text("vehicle: light.yaml\n")
    with pytest.raises(ConfigError, match=r"parts/light\.yaml: No such file"):
        ControllerConfig.from_yaml(files / "parts/mine.yaml")


def test_data_without_a_file_counts_from_where_the_process_runs(files, monkeypatch):
    monkeypatch.chdir(files / "parts/vehicles")
    config = ControllerConfig.parse({"vehicle": "light.yaml"}, "data")
    assert config.vehicle.mass_kg == 2.5
