# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The trials of a campaign that came closest to the tower, and how to fly each again."""

import shlex
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from gtmr_study.campaign.figures import Campaign
from gtmr_study.scenario_file import ScenarioFile

LISTED = 5
"""So many trials of each mode are listed."""


@dataclass(frozen=True)
class WorstTrial:
    """A trial, with the command that flies it again."""

    row: pd.Series
    """Its row of trials.csv."""
    command: str
    """In the folder of the page; empty if there is none."""


def worst_trials(campaign: Campaign, mode: str) -> list[pd.Series]:
    """Pick the rows of a mode whose least clearance is smallest, the smallest first."""
    rows = campaign.flown[mode].sort_values(["min_clearance_m", "trial"]).head(LISTED)
    return [row for _, row in rows.iterrows()]


def write_worst(campaign: Campaign, folder: Path) -> dict[str, list[WorstTrial]]:
    """Write what ``gtmr fly --scenario`` needs of the worst trials into a folder, by mode.

    The commands name the files as seen from the folder's parent. A controller of one's own is in
    no such file, so its trials have no command.
    """
    own = campaign.study.own_controller is not None
    found = {}
    for mode in campaign.flown:
        found[mode] = [
            WorstTrial(row, "" if own else _write(campaign, mode, row, folder))
            for row in worst_trials(campaign, mode)
        ]
    return found


def _write(campaign: Campaign, mode: str, row: pd.Series, folder: Path) -> str:
    study, trial = campaign.study, int(row["trial"])
    least_m = row["min_clearance_any_time_m"]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{mode}-{trial}.yaml"
    ScenarioFile(
        mode=mode,
        duration_s=study.duration_s,
        controller=study.controller,
        scenario=study.against(mode).scenario(trial),
        min_clearance_m=None if pd.isna(least_m) else float(least_m),
    ).write(path)
    return f"gtmr fly --scenario {shlex.quote(f'{folder.name}/{path.name}')}"
