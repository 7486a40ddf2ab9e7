# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A name for C sources that have not been generated: all that they are made from.

To generate the sources of a problem takes longer than to load the library that they make. A recipe
stands for them: equal recipes are equal sources, so that a library may be found by it. It is
complete, because generated sources are a function of these alone:

- what the generator is given, exact to the last bit: models with their classes and every field,
  and numbers. Whoever generates must use nothing else;
- the generator: every byte of every module, C file and header in the packages that it is part of,
  which is more than it reads. A class from elsewhere, as a path of one's own, may do anything, so
  that there is no recipe of it;
- what the generator calls: CasADi by its version and the file that would be loaded, NumPy and
  Python by their versions. Compiler, flags and processor are in the cache's key anyway.

What a file holds is what this process runs only if it has not changed since it was imported: where
one has, or in the minute before, there is no recipe. Not covered are functions replaced in memory,
and Python's own bytecode where a source was saved twice within a second at the same size.

No recipe is no harm: the sources are generated, and the library is found by their text.
"""

from __future__ import annotations

import hashlib
import importlib.util
import platform
import sys
from collections.abc import Sequence
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

import gtmr_codegen
import gtmr_model
from gtmr_model import YamlModel

PACKAGES = ("gtmr_model", "gtmr_codegen")
"""What every generator is made of, beside its own package."""
SUFFIXES = (".py", ".c", ".h")
"""Of the files that count."""
SETTLED_NS = 60_000_000_000
"""For how long a file must not have changed when its package was imported [ns]: time stamps are
coarse, and a package is imported for a while before it says when."""

Value = YamlModel | str | float | int | None | Sequence[Any]
"""What a generator may be given."""


def recipe(package: str, *values: Value) -> str | None:
    """Name the sources that a generator in a package makes of these values, and of nothing else.

    None where that cannot be said.
    """
    try:
        generator = _generator(package)
        told = [_told(value, (*PACKAGES, package)) for value in values]
    except _Unknown:
        return None
    return _digest("\0".join([generator, *told]).encode())


def still_holds(package: str) -> bool:
    """Whether the generator is what it was when the first recipe was made, read anew."""
    try:
        return _generator(package) == _generator.__wrapped__(package)
    except _Unknown:
        return False


class _Unknown(Exception):
    """What something is made of cannot be said."""


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@lru_cache(maxsize=8)
def _generator(package: str) -> str:
    loaded_ns = min(gtmr_model.LOADED_NS, gtmr_codegen.LOADED_NS)
    parts = [sys.version, platform.machine(), np.__version__, _casadi()]
    for name in (*PACKAGES, package):
        parts.append(sources_digest(_folder(name), loaded_ns - SETTLED_NS))
    return _digest("\0".join(parts).encode())


def _folder(package: str) -> Path:
    file = getattr(sys.modules.get(package), "__file__", None)
    if file is None:
        raise _Unknown
    return Path(file).parent


def sources_digest(folder: Path, unchanged_since_ns: int) -> str:
    """Digest every source in a folder, by its path and bytes.

    Raises `_Unknown` if one cannot be read, or has changed since a time [ns since 1970].
    """
    digest = hashlib.sha256()
    try:
        files = sorted(path for path in folder.rglob("*") if path.suffix in SUFFIXES)
        for path in files:
            status = path.stat()
            # The change time too: a file that is moved here keeps the time of its content.
            if max(status.st_mtime_ns, status.st_ctime_ns) > unchanged_since_ns:
                raise _Unknown
            name, content = str(path.relative_to(folder)).encode(), path.read_bytes()
            digest.update(b"%d %s %d " % (len(name), name, len(content)))
            digest.update(content)
    except OSError:
        raise _Unknown from None
    if not files:
        raise _Unknown
    return digest.hexdigest()


def _casadi() -> str:
    """Say which CasADi would be loaded, without loading it."""
    try:
        spec = importlib.util.find_spec("casadi")
        if spec is None or spec.origin is None:
            raise _Unknown
        status = Path(spec.origin).stat()
        return f"{metadata.version('casadi')} {spec.origin} {status.st_size} {status.st_mtime_ns}"
    except (OSError, ValueError, metadata.PackageNotFoundError):
        raise _Unknown from None


def _told(value: Any, packages: tuple[str, ...]) -> str:
    """Write a value exactly, with the class of every model in it."""
    if isinstance(value, YamlModel):
        kind = type(value)
        # A class of somebody else's may look like one of ours, and make other formulas.
        if kind.__module__.partition(".")[0] not in packages or "<locals>" in kind.__qualname__:
            raise _Unknown
        fields = [f"{n}={_told(getattr(value, n), packages)}" for n in kind.model_fields]
        return f"{kind.__module__}.{kind.__qualname__}({', '.join(fields)})"
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(_told(each, packages) for each in value)}]"
    # An exact float, and no subclass of one that is written otherwise.
    if value is None or type(value) in (str, float, int, bool):
        return repr(value)
    raise _Unknown
