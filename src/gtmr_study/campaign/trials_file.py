# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The folder of a campaign: its study, and one row per flown trial."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pandas as pd

from gtmr_study.campaign.study import Study, mode_order
from gtmr_study.campaign.trial import COLUMNS, FIRST_COLUMNS
from gtmr_study.result_files import InputError
from gtmr_study.results_folder import Kind, RowsFile

TRIALS_FILE = "trials.csv"
CAMPAIGN = Kind("a campaign", "study", Study)


def is_campaign(folder: Path) -> bool:
    """Tell whether a folder, which need not exist, holds a campaign."""
    return CAMPAIGN.is_in(folder)


def read_study(folder: Path) -> Study:
    """Read what a campaign folder is of; InputError if it is none, or none of this version."""
    return CAMPAIGN.read(folder)


def read_trials(folder: Path) -> pd.DataFrame:
    """Read the rows of a campaign, the columns of trials.csv; InputError if there are none.

    A campaign of before has empty cells in the columns that were added since.
    """
    path = folder / TRIALS_FILE
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    if tuple(table.columns) not in (COLUMNS, FIRST_COLUMNS):
        raise InputError(f"{path}: does not have the columns of a campaign")
    return table.reindex(columns=list(COLUMNS))


def require_own_or_empty(option: str, folder: Path, study: Study) -> None:
    """Check that an option's folder is new, empty, or of this very campaign; change nothing.

    InputError names what else it holds.
    """
    CAMPAIGN.require_own_or_empty(option, folder, _as_flown(study))


@contextmanager
def open_campaign(option: str, folder: Path, study: Study) -> Iterator[RowsFile]:
    """Start a campaign's folder, or take up one that was interrupted; errors as `Kind.opened`."""
    with CAMPAIGN.opened(option, folder, _as_flown(study)):
        yield RowsFile(folder / TRIALS_FILE, COLUMNS, _trial_and_mode, CAMPAIGN.what)


def in_order(flight: tuple[int, str]) -> tuple[int, int]:
    """Place of a trial and mode in the file."""
    trial, mode = flight
    return trial, mode_order(mode)


def _trial_and_mode(row: Sequence[str]) -> tuple[int, str]:
    return int(row[0]), row[1]


def _as_flown(study: Study) -> Study:
    # The number of trials as it is flown, be it given or left to the plan.
    return study.model_copy(update={"trials": study.n_trials})
