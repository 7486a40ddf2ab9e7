# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A folder of results that can be gone on with: what it is of, and rows, safe against kill -9."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from gtmr_model import YamlModel
from gtmr_study.result_files import UNFINISHED, InputError, write_json, write_whole

Plan = TypeVar("Plan", bound=YamlModel)
Key = tuple[Any, ...]

FORMAT = 1
"""Version of the folders; another one is refused."""


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


@dataclass(frozen=True)
class Kind(Generic[Plan]):
    """What a folder holds results of, and the file that says of which."""

    what: str
    """As messages call it, with its article."""
    key: str
    """What the file calls its content; the file is called like it."""
    plan: type[Plan]
    """What is planned; the same plan is the same results."""

    @property
    def file(self) -> str:
        """Name of the file."""
        return f"{self.key}.json"

    def is_in(self, folder: Path) -> bool:
        """Tell whether a folder, which need not exist, holds such results."""
        return (folder / self.file).is_file()

    def read(self, folder: Path) -> Plan:
        """Read what a folder is of; InputError if it holds none, or none of this version."""
        path, name = folder / self.file, self.what.split()[-1]
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            version, plan = content["format"], content[self.key]
        except OSError as error:
            raise InputError(f"{folder}: holds no {name}: {path.name}: {error.strerror}") from None
        except (ValueError, KeyError, TypeError):
            raise InputError(f"{path}: is no description of {self.what}") from None
        if version != FORMAT:
            raise InputError(f"{path}: format {version!r} is not known, expected {FORMAT}")
        return self.plan.parse(plan, str(path))

    def require_own_or_empty(self, option: str, folder: Path, plan: Plan) -> None:
        """Check that an option's folder is new, empty, or of this very plan; change nothing.

        InputError names what else it holds.
        """
        name = self.what.split()[-1]
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{option} = {folder}: is a file, expected a folder")
        if not folder.is_dir():
            return
        if not self.is_in(folder):
            # A start that was killed may have left this one file.
            others = [path for path in folder.iterdir() if not path.name.startswith(UNFINISHED)]
            if others:
                raise InputError(
                    f"{option} = {folder}: holds {others[0].name} but no {name}; nothing was "
                    "changed: give a new or empty folder"
                )
            return
        theirs = self.read(folder).model_dump()
        ours = self.plan.parse(plan.model_dump(mode="json"), self.key).model_dump()
        for field in ours:
            if theirs[field] != ours[field]:
                there, here = _difference(field, theirs[field], ours[field])
                raise InputError(
                    f"{option} = {folder}: holds another {name}, with {there} where this one has "
                    f"{here}; nothing was changed: give another folder"
                )

    @contextmanager
    def opened(self, option: str, folder: Path, plan: Plan) -> Iterator[None]:
        """Start a folder, or take up one that was interrupted, for as long as the context lasts.

        InputError if the folder holds anything else, or another process is at work in it; it is
        then left as it was. ResultsError if the folder cannot be written.
        """
        self.require_own_or_empty(option, folder, plan)
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            if not self.is_in(folder):
                content = {"format": FORMAT, self.key: plan.model_dump(mode="json")}
                write_json(folder / self.file, content)
            lock = (folder / self.file).open("rb")
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                name = self.what.split()[-1]
                raise InputError(
                    f"{option} = {folder}: another process is flying this {name}"
                ) from None
            yield


class RowsFile:
    """Rows in a CSV file; each is on its way to the disk before `append` returns.

    A last line that a killed writer left unfinished is cut off. InputError if the file has other
    columns, ResultsError if it cannot be written.
    """

    def __init__(
        self, path: Path, columns: Sequence[str], key: Callable[[Sequence[str]], Key], what: str
    ) -> None:
        """Open or begin the file; ``key`` makes what names a row of the texts of its cells."""
        self.path, self.columns, self.key = path, tuple(columns), key
        self.done: set[Key] = set()
        """Names of the rows that are there."""
        with writing(path):
            self._take_up(what)

    def append(self, rows: Sequence[dict[str, Any]]) -> None:
        """Add rows; ResultsError if the disk is full, for example: what was there before stays."""
        text = io.StringIO()
        csv.DictWriter(text, self.columns, lineterminator="\n").writerows(rows)
        self._write(text.getvalue())
        self.done |= set(map(self.key, csv.reader(text.getvalue().splitlines())))

    def rows(self) -> list[dict[str, str]]:
        """Read the texts of all cells, by column."""
        with self.path.open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    def sort(self, order: Callable[[Key], Any]) -> None:
        """Put the rows in order of their names, however they came in."""
        header, *lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True)
        keys = map(self.key, csv.reader(lines))
        named = sorted(zip(keys, lines, strict=True), key=lambda pair: order(pair[0]))
        with writing(self.path):
            write_whole(self.path, header + "".join(line for _, line in named))

    def _take_up(self, what: str) -> None:
        content = self.path.read_bytes() if self.path.exists() else b""
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            os.truncate(self.path, whole)
        if not whole:
            self._write(",".join(self.columns) + "\n")
            return
        header, *rows = csv.reader(content[:whole].decode("utf-8").splitlines())
        if tuple(header) != self.columns:
            raise InputError(f"{self.path}: does not have the columns of {what}")
        self.done = set(map(self.key, rows))

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


def _difference(name: str, theirs: Any, ours: Any) -> tuple[str, str]:
    """Say where two settings differ, as far down as they have fields."""
    if isinstance(theirs, dict) and isinstance(ours, dict):
        for key in ours:
            if theirs.get(key) != ours[key]:
                return _difference(f"{name}.{key}", theirs.get(key), ours[key])
    return f"{name} = {theirs!r}", repr(ours)
