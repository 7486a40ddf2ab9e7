# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Where results go: nothing that exists is overwritten, and no half-written file is left."""

import json
from pathlib import Path
from typing import Any


class InputError(ValueError):
    """Bad input of a command; the message is one line for the user."""


def require_new_file(option: str, path: Path | None) -> None:
    """Check that an option's file can be written without overwriting anything; None passes.

    InputError if the file exists, or its folder does not.
    """
    if path is None:
        return
    if path.exists():
        raise InputError(f"{option} = {path}: exists already and is not overwritten")
    require_folder_of(option, path)


def require_folder_of(option: str, path: Path | None) -> None:
    """Check that the folder of an option's file exists, and the file is no folder; None passes."""
    if path is None:
        return
    if not path.absolute().parent.is_dir():
        raise InputError(f"{option} = {path}: there is no folder {path.absolute().parent}")
    if path.is_dir():
        raise InputError(f"{option} = {path}: is a folder, expected a file")


def require_empty_folder(option: str, path: Path) -> None:
    """Check that the folder of an option is new or empty; InputError if it is not."""
    if path.exists() and not path.is_dir():
        raise InputError(f"{option} = {path}: is a file, expected a new or empty folder")
    if path.is_dir() and any(path.iterdir()):
        raise InputError(f"{option} = {path}: is not empty and is not overwritten")


def write_json(path: Path | None, result: dict[str, Any]) -> None:
    """Write a result as JSON, whole or not at all; None as path writes nothing."""
    if path is not None:
        write_whole(path, json.dumps(result, indent=2) + "\n")


def write_whole(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def one_line(error: BaseException) -> str:
    """Say what was raised, in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
