# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""One flight as a file, which ``gtmr fly --scenario`` flies again."""

from __future__ import annotations

from pathlib import Path

import yaml
from pydantic import Field

from gtmr_model import YamlModel
from gtmr_nmpc import ControllerConfig
from gtmr_sim import Scenario
from gtmr_study.result_files import write_whole

DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
"""The one in C takes a tenth of the time, where PyYAML has it."""


class ScenarioFile(YamlModel):
    """What flies a flight again, apart from the file of a controller of one's own."""

    mode: str
    """Who flies: a controller of the arena, the modes among them, or a class of one's own."""
    duration_s: float = Field(gt=0.0, le=86400.0)
    """Its length [s]."""
    controller: ControllerConfig
    """What the controller believes in."""
    scenario: Scenario
    """The vehicle, the world, the gusts and the start."""
    min_clearance_m: float | None = None
    """What was found: least d_T of any plant step [m]."""

    def write(self, path: Path) -> None:
        """Write it as YAML, whole or not at all."""
        content = self.model_dump(mode="json")
        text = yaml.dump(content, Dumper=DUMPER, sort_keys=False, allow_unicode=True)
        write_whole(path, text)
