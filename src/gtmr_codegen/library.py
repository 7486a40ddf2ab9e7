# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""C sources to a loaded shared library, through a cache that belongs to the user."""

import ctypes
import fcntl
import hashlib
import os
import platform
import shlex
import shutil
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, lru_cache
from pathlib import Path

from gtmr_codegen.recipe import Value, recipe, still_holds

FLAGS = (
    "-std=c99",
    "-fPIC",
    "-march=native",
    # Neither changes a result: nobody looks at libm's errno or at floating-point exceptions.
    "-fno-math-errno",
    "-fno-trapping-math",
)
"""Flags of every file; none lets the compiler reorder floating-point operations."""
COMPILERS = ("cc", "gcc", "clang")
"""Tried in this order where $CC does not name one."""


class CompileError(RuntimeError):
    """No C compiler works; the message is one line that says what was tried."""


def load_library(
    title: str, sources: Mapping[str, str], flags: Mapping[str, tuple[str, ...]]
) -> ctypes.CDLL:
    """Load the library that C sources make, compiling them unless the user's cache has it.

    Compiling takes a while, and says so in a line on stderr. Any number of processes may ask for
    the same library at once; one of them compiles it. A file in the cache that is not as it was
    written there, or is not the user's own, is never loaded but made again. Raises CompileError if
    there is no compiler, or it fails, or what it made can be neither written nor loaded.
    """
    compiler = _compiler()
    key = _key(compiler, _text(sources, flags))
    home = _cache_folder()
    with suppress(OSError):
        if (entry := _find(home, key)) is not None:
            return ctypes.CDLL(str(entry))
    with _turn(home):
        return _found_or_made(title, home, key, compiler, sources, flags)


Sources = Mapping[str, str]
Flags = Mapping[str, tuple[str, ...]]


def load_generated(
    title: str, package: str, values: Sequence[Value], make: Callable[[], tuple[Sources, Flags]]
) -> ctypes.CDLL:
    """Load the library of sources that a generator in a package makes of values alone.

    As `load_library`, but the sources, with their flags, are only made where no library is found
    by their `recipe`. One that is found by the sources then gets the recipe as a second name.
    """
    named = recipe(package, *values)
    if named is None:
        return load_library(title, *make())
    home, key = _cache_folder(), _key(_compiler(), [named])
    with suppress(OSError):
        if (entry := _find(home, key)) is not None:
            return ctypes.CDLL(str(entry))
    sources, flags = make()
    library = load_library(title, sources, flags)
    made = _find(home, _key(_compiler(), _text(sources, flags)))
    if home is not None and made is not None and still_holds(package):
        with suppress(OSError):
            os.link(made, home / f"{key}-{made.stem.rpartition('-')[2]}.so")
    return library


def _key(compiler: tuple[str, ...], of: Sequence[str]) -> str:
    parts = [*compiler, *FLAGS, _version(compiler), _cpu(), *of]
    return _digest("\0".join(parts).encode())


def _text(sources: Sources, flags: Flags) -> list[str]:
    named = sorted(sources.items())
    return [part for name, text in named for part in (name, text, *flags.get(name, ()))]


def _found_or_made(
    title: str,
    home: Path | None,
    key: str,
    compiler: tuple[str, ...],
    sources: Mapping[str, str],
    flags: Mapping[str, tuple[str, ...]],
) -> ctypes.CDLL:
    with suppress(OSError):
        if (entry := _find(home, key)) is not None:
            return ctypes.CDLL(str(entry))
    start = time.perf_counter()
    _say(f"gtmr: compiling {title}, once for this machine ...", end=" ")
    try:
        library = _make(home, key, compiler, sources, flags)
    except CompileError:
        _say("failed")
        raise
    _say(f"done in {time.perf_counter() - start:.0f} s")
    return library


@cache
def _warn_once(reason: str) -> None:
    _say(
        f"gtmr: {reason}: going on interpreted, with the same answers but many times slower; "
        "install a C compiler, or name one in $CC"
    )


def warn_interpreted(error: CompileError) -> None:
    """Say on stderr, once for each reason, that there is no compiled code and what to do."""
    _warn_once(str(error))


def _say(text: str, end: str = "\n") -> None:
    sys.stderr.write(text + end)
    sys.stderr.flush()


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def _compiler() -> tuple[str, ...]:
    named = shlex.split(os.environ.get("CC", ""))
    for command in [named] if named else [[name] for name in COMPILERS]:
        if shutil.which(command[0]):
            return tuple(command)
    raise CompileError(f"no C compiler found (tried {' '.join(named) or ', '.join(COMPILERS)})")


@lru_cache(maxsize=8)
def _version(compiler: tuple[str, ...]) -> str:
    return _run([*compiler, "--version"]).stdout


@lru_cache(maxsize=1)
def _cpu() -> str:
    """Name what -march=native depends on."""
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        names = ("model name", "flags", "Features", "CPU part")
        return "\n".join(sorted({line for line in lines if line.startswith(names)}))
    return f"{platform.machine()} {platform.processor()}"


def _cache_folder() -> Path | None:
    """Find the user's own folder; none where there is none to write in or to trust."""
    with suppress(OSError, RuntimeError):  # RuntimeError: a user without a home
        home = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
        folder = Path(home) / "gtmr"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if _is_own(folder.lstat()) and os.access(folder, os.W_OK):
            return folder
    return None


def _is_own(status: os.stat_result) -> bool:
    """Whether nobody but this user can have written it."""
    writable_by_others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return status.st_uid == os.getuid() and not writable_by_others


@contextmanager
def _turn(folder: Path | None) -> Iterator[None]:
    """Wait until no other process compiles: it may be what this one is about to."""
    with ExitStack() as held:
        # The folder itself is what is locked. Where that cannot be, both compile.
        with suppress(OSError):
            if folder is not None:
                descriptor = os.open(folder, os.O_RDONLY)
                held.callback(os.close, descriptor)
                fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield


def _find(folder: Path | None, key: str) -> Path | None:
    """Find an entry that is what its name says; clear away what only pretends to be."""
    if folder is None:
        return None
    for entry in folder.glob(f"{key}-*.so"):
        with suppress(OSError):
            genuine = (
                not entry.is_symlink()
                and _is_own(entry.stat())
                and entry.name == f"{key}-{_digest(entry.read_bytes())}.so"
            )
            if genuine:
                return entry
            entry.unlink()
    return None


def _make(
    home: Path | None,
    key: str,
    compiler: tuple[str, ...],
    sources: Mapping[str, str],
    flags: Mapping[str, tuple[str, ...]],
) -> ctypes.CDLL:
    """Build and load in the cache, or for once in a temporary folder where the cache fails."""
    if home is not None:
        # CompileError as well: it is what a full disk makes of the compiler.
        with suppress(OSError, CompileError):
            return ctypes.CDLL(str(_build(home, key, compiler, sources, flags)))
    try:
        with tempfile.TemporaryDirectory(prefix="gtmr-") as folder:
            return ctypes.CDLL(str(_build(Path(folder), key, compiler, sources, flags)))
    except OSError as error:
        reason = " ".join((error.strerror or str(error)).split())
        raise CompileError(f"compiled code cannot be written or loaded: {reason}") from None


def _build(
    folder: Path,
    key: str,
    compiler: tuple[str, ...],
    sources: Mapping[str, str],
    flags: Mapping[str, tuple[str, ...]],
) -> Path:
    """Compile in a folder of this process alone, then move the result into the cache at once."""
    with tempfile.TemporaryDirectory(dir=folder, prefix="build-") as name:
        work = Path(name)
        for file, text in sources.items():
            (work / file).write_text(text, encoding="utf-8")
        units = [file for file in sources if file.endswith(".c")]
        commands = [
            [
                *compiler,
                *FLAGS,
                *flags.get(unit, ()),
                "-c",
                str(work / unit),
                "-o",
                f"{work / unit}.o",
            ]
            for unit in units
        ]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(_run, commands))
        objects = [f"{work / unit}.o" for unit in units]
        library = work / "library.so"
        _run([*compiler, "-shared", "-o", str(library), *objects, "-lm"])
        library.chmod(0o600)
        entry = folder / f"{key}-{_digest(library.read_bytes())}.so"
        library.replace(entry)
    return entry


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True)
    except OSError as error:
        raise CompileError(f"{command[0]}: {error.strerror}") from None
    except subprocess.CalledProcessError as error:
        said = error.stderr.strip().splitlines()
        errors = [line for line in said if "error:" in line] or said
        reason = errors[0] if errors else f"exit code {error.returncode}"
        raise CompileError(f"{command[0]} failed: {reason}") from None
