# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The folder of a campaign: what it is of, and one row per flown trial, safe against kill -9."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd

from gtmr_study.campaign.study import Study, mode_order
from gtmr_study.campaign.trial import COLUMNS, FIRST_COLUMNS, Row
from gtmr_study.result_files import UNFINISHED, InputError, write_json, write_whole

STUDY_FILE = "study.json"
TRIALS_FILE = "trials.csv"
FORMAT = 1
"""Version of the folder; another one is refused."""


class ResultsError(OSError):
    """Results cannot be written; the message is one line for the user."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what keeps a file from being written into a `ResultsError` that names it."""
    try:
        yield
    except ResultsError:
        raise
    except OSError as error:
        raise ResultsError(f"{path}: cannot be written: {error.strerror}") from None


def is_campaign(folder: Path) -> bool:
    """Tell whether a folder, which need not exist, holds a campaign."""
    return (folder / STUDY_FILE).is_file()


def read_study(folder: Path) -> Study:
    """Read what a campaign folder is of; InputError if it is none, or none of this version."""
    path = folder / STUDY_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        version, study = content["format"], content["study"]
    except OSError as error:
        raise InputError(f"{folder}: holds no campaign: {path.name}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path}: is no description of a campaign") from None
    if version != FORMAT:
        raise InputError(f"{path}: format {version!r} is not known, expected {FORMAT}")
    return Study.parse(study, str(path))


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
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{option} = {folder}: is a file, expected a folder")
    if not folder.is_dir():
        return
    if not is_campaign(folder):
        # A start that was killed may have left this one file.
        others = [path for path in folder.iterdir() if not path.name.startswith(UNFINISHED)]
        if others:
            raise InputError(
                f"{option} = {folder}: holds {others[0].name} but no campaign; nothing was "
                "changed: give a new or empty folder"
            )
        return
    theirs, ours = read_study(folder).model_dump(), _description(study)["study"]
    ours = Study.parse(ours, "study").model_dump()
    for name in ours:
        if theirs[name] != ours[name]:
            there, here = _difference(name, theirs[name], ours[name])
            raise InputError(
                f"{option} = {folder}: holds another campaign, with {there} where this one has "
                f"{here}; nothing was changed: give another folder"
            )


@contextmanager
def open_campaign(option: str, folder: Path, study: Study) -> Iterator[TrialsFile]:
    """Start a campaign's folder, or take up one that was interrupted.

    InputError if the folder holds anything else, or another process is at work in it; it is then
    left as it was. ResultsError if the folder cannot be written.
    """
    require_own_or_empty(option, folder, study)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if not is_campaign(folder):
            write_json(folder / STUDY_FILE, _description(study))
        lock = (folder / STUDY_FILE).open("rb")
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(
                f"{option} = {folder}: another process is flying this campaign"
            ) from None
        yield TrialsFile(folder / TRIALS_FILE)


class TrialsFile:
    """The rows of a campaign; each is on its way to the disk before `append` returns.

    A last line that a killed writer left unfinished is cut off.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.done: set[tuple[int, str]] = set()
        with writing(path):
            self._take_up()

    def append(self, rows: Sequence[Row]) -> None:
        """Add rows; ResultsError if the disk is full, for example: what was there before stays."""
        text = io.StringIO()
        csv.DictWriter(text, COLUMNS, lineterminator="\n").writerows(rows)
        self._write(text.getvalue())
        self.done |= {(row["trial"], row["mode"]) for row in rows}

    def sort(self) -> None:
        """Put the rows in order of trial and mode, however they came in."""
        header, *lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True)

        def key(line: str) -> tuple[int, int]:
            trial, mode, _ = line.split(",", 2)
            return int(trial), mode_order(mode)

        with writing(self.path):
            write_whole(self.path, header + "".join(sorted(lines, key=key)))

    def _take_up(self) -> None:
        content = self.path.read_bytes() if self.path.exists() else b""
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            os.truncate(self.path, whole)
        if not whole:
            self._write(",".join(COLUMNS) + "\n")
            return
        header, *rows = csv.reader(content[:whole].decode("utf-8").splitlines())
        if tuple(header) != COLUMNS:
            raise InputError(f"{self.path}: does not have the columns of a campaign")
        self.done = {(int(row[0]), row[1]) for row in rows}

    def _write(self, text: str) -> None:
        size = self.path.stat().st_size if self.path.exists() else 0
        with writing(self.path):
            try:
                with self.path.open("ab", buffering=0) as file:
                    data = text.encode("utf-8")
                    written = file.write(data)
                    if written < len(data):
                        file.write(data[written:])
            except OSError:
                os.truncate(self.path, size)
                raise


def _description(study: Study) -> dict[str, Any]:
    # The number of trials as it is flown, be it given or left to the plan.
    named = study.model_copy(update={"trials": study.n_trials})
    return {"format": FORMAT, "study": named.model_dump(mode="json")}


def _difference(name: str, theirs: Any, ours: Any) -> tuple[str, str]:
    """Say where two settings differ, as far down as they have fields."""
    if isinstance(theirs, dict) and isinstance(ours, dict):
        for key in ours:
            if theirs.get(key) != ours[key]:
                return _difference(f"{name}.{key}", theirs.get(key), ours[key])
    return f"{name} = {theirs!r}", repr(ours)
