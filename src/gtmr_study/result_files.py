# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Where results go: nothing that exists is overwritten, and no half-written file is left."""

import json
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

UNFINISHED = ".gtmr-unfinished-"
"""Beginning of the names of files that are being written, or whose writer was killed."""


class InputError(ValueError):
    """Bad input of a command; the message is one line for the user."""


def require_new_file(option: str, path: Path | None) -> None:
    """Check that an option's file can be written without overwriting anything; None passes.

    InputError if the file exists, or cannot be written.
    """
    if path is None:
        return
    with _usable(option, path):
        if path.exists() or path.is_symlink():
            raise InputError(f"{option} = {path}: exists already and is not overwritten")
    require_folder_of(option, path)


def require_folder_of(option: str, path: Path | None) -> None:
    """Check that an option's file can be written, by writing beside it; None passes.

    InputError if its folder does not exist or takes no files, or the file is a folder.
    """
    if path is None:
        return
    with _usable(option, path):
        if path.is_dir():
            raise InputError(f"{option} = {path}: is a folder, expected a file")
        target = Path(os.path.realpath(path))
        if not target.parent.is_dir():
            raise InputError(f"{option} = {path}: there is no folder {target.parent}")
        if path.exists() and not path.is_file():
            return
        with _unfinished(target):
            pass


def require_empty_folder(option: str, path: Path) -> None:
    """Check that the folder of an option is new or empty, and can be made; InputError if not."""
    with _usable(option, path):
        if path.exists() and not path.is_dir():
            raise InputError(f"{option} = {path}: is a file, expected a new or empty folder")
        if path.is_dir() and any(path.iterdir()):
            raise InputError(f"{option} = {path}: is not empty and is not overwritten")
    require_folder(option, path)


def require_folder(option: str, path: Path) -> None:
    """Check that an option's folder, which need not exist, can be made and written into.

    InputError if not. Nothing is left behind.
    """
    with _usable(option, path):
        if path.exists() and not path.is_dir():
            raise InputError(f"{option} = {path}: is a file, expected a folder")
        # A link to nothing is in the way of a folder.
        places = (path, *path.absolute().parents)
        nearest = next(each for each in places if each.exists() or each.is_symlink())
        with _unfinished(nearest / "file"):
            pass


@contextmanager
def _usable(option: str, path: Path) -> Iterator[None]:
    """Turn what the file system says of a path into an InputError."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{option} = {path}: cannot be written: {error.strerror}") from None


def write_json(path: Path | None, result: dict[str, Any] | list[Any]) -> None:
    """Write a result as JSON, whole or not at all; None as path writes nothing.

    Raises OSError if it cannot be written.
    """
    if path is not None:
        write_whole(path, json.dumps(result, indent=2) + "\n")


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file whole or not at all, text as UTF-8; a link keeps pointing where it does.

    A device or a pipe is written to. Raises OSError if it cannot be written.
    """
    data = content.encode() if isinstance(content, str) else content
    if path.exists() and not path.is_file():
        path.write_bytes(data)
        return
    target = Path(os.path.realpath(path))
    with _unfinished(target) as unfinished:
        unfinished.write_bytes(data)
        unfinished.replace(target)


@contextmanager
def _unfinished(target: Path) -> Iterator[Path]:
    """Make a file of a name that nobody has beside another; remove it if it is still there."""
    path = target.parent / f"{UNFINISHED}{secrets.token_hex(8)}"
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


def one_line(error: BaseException) -> str:
    """Say what was raised, in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
