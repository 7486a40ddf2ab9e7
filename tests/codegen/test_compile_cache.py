# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The cache of compiled code: shared between processes, trusted only as far as it deserves."""

import ctypes
import errno
import fcntl
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gtmr_codegen import library
from gtmr_codegen.library import CompileError, load_library
from gtmr_model import Helix, Tower, Vehicle
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_sim import Scenario, fly, plant

SOURCES = {"answer.c": "int answer(void);\nint answer(void)\n{\n    return 42;\n}\n"}
LOAD = f"""
from gtmr_codegen.library import load_library
print(load_library("a test", {SOURCES!r}, {{}}).answer())
"""


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """Give an empty cache of its own; the folder itself is made when needed."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "gtmr"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Give a cache in which another process has made the entry."""
    folder = tmp_path_factory.mktemp("made")
    environment = os.environ | {"XDG_CACHE_HOME": str(folder)}
    subprocess.run([sys.executable, "-c", LOAD], check=True, capture_output=True, env=environment)
    return folder / "gtmr"


def answer():
    return load_library("a test", SOURCES, {}).answer()


def test_compiled_once_with_one_line_on_stderr(cache, capfd):
    assert [answer(), answer()] == [42, 42]
    told = capfd.readouterr().err.splitlines()
    assert [re.sub(r"\d+ s$", "# s", line) for line in told] == [
        "gtmr: compiling a test, once for this machine ... done in # s"
    ]
    assert len(list(cache.iterdir())) == 1
    assert cache.stat().st_mode & 0o077 == 0


def test_of_processes_that_start_at_once_one_compiles_and_all_get_it(cache):
    start = [sys.executable, "-c", f"print('asks', flush=True)\n{LOAD}"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    cache.mkdir(mode=0o700)
    # Held as by one that compiles, until all have come to ask.
    descriptor = os.open(cache, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    processes = [subprocess.Popen(start, **pipes) for _ in range(3)]
    assert [process.stdout.readline() for process in processes] == ["asks\n"] * 3
    os.close(descriptor)
    ended = [process.communicate(timeout=60) for process in processes]
    assert [answer for answer, _ in ended] == ["42\n"] * 3
    assert sum("compiling" in said for _, said in ended) == 1
    assert len(list(cache.glob("*.so"))) == 1


@pytest.mark.parametrize("harm", ["truncated", "exchanged", "writable by others", "a link"])
def test_an_entry_that_is_corrupt_or_foreign_is_made_again(made, cache, tmp_path, harm):
    shutil.copytree(made, cache)
    (entry,) = cache.glob("*.so")
    good = entry.read_bytes()
    match harm:
        case "truncated":
            entry.write_bytes(good[:100])
        case "exchanged":
            entry.write_bytes(good.replace(b"\x2a\x00\x00\x00", b"\x2b\x00\x00\x00"))
        case "writable by others":
            entry.chmod(0o666)
        case "a link":
            elsewhere = tmp_path / "elsewhere.so"
            elsewhere.write_bytes(good)
            entry.unlink()
            entry.symlink_to(elsewhere)
    done = subprocess.run([sys.executable, "-c", LOAD], check=True, capture_output=True, text=True)
    assert done.stdout == "42\n"
    assert "compiling" in done.stderr
    (entry,) = cache.glob("*.so")
    assert entry.read_bytes() == good
    assert not entry.is_symlink()
    assert entry.stat().st_mode & 0o077 == 0


def test_a_cache_that_others_may_write_is_not_used(cache):
    cache.mkdir()
    cache.chmod(0o777)
    assert answer() == 42
    assert not list(cache.iterdir())


def test_other_sources_and_flags_are_other_entries(cache):
    other = {"answer.c": SOURCES["answer.c"].replace("42", "WHAT")}
    assert answer() == 42
    for what in (1, 2):
        assert load_library("a test", other, {"answer.c": (f"-DWHAT={what}",)}).answer() == what
    assert len(list(cache.iterdir())) == 3


def test_an_error_of_the_compiler_is_one_line(cache):
    with pytest.raises(CompileError, match=r"failed: .*answer\.c.*error") as raised:
        load_library("a test", {"answer.c": "int answer(void) { return nonsense; }"}, {})
    assert "\n" not in str(raised.value)
    assert not list(cache.glob("*.so"))


def test_a_named_compiler_that_is_not_there_is_an_error(cache, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler -O2")
    with pytest.raises(CompileError, match=r"no C compiler found .*no-such-compiler"):
        answer()


def no_space(*_arguments, **_options):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_cache_on_a_full_disk_is_bypassed(cache, monkeypatch, capfd):
    write = Path.write_text
    monkeypatch.setattr(
        Path,
        "write_text",
        lambda self, *a, **k: (no_space if cache in self.parents else write)(self, *a, **k),
    )
    assert answer() == 42
    assert "done in" in capfd.readouterr().err


def test_a_compiler_that_finds_the_disk_full_is_tried_elsewhere(cache, tmp_path, monkeypatch):
    compiler = tmp_path / "cc"
    compiler.write_text(
        f'#!/bin/sh\ncase "$*" in *{cache}*) echo error: No space left on device >&2; exit 1;;'
        ' esac\nexec cc "$@"\n'
    )
    compiler.chmod(0o700)
    monkeypatch.setenv("CC", str(compiler))
    assert answer() == 42
    assert not list(cache.glob("*.so"))


def test_an_entry_that_cannot_be_loaded_from_the_cache_is_loaded_from_elsewhere(
    made, cache, monkeypatch
):
    shutil.copytree(made, cache)
    load = ctypes.CDLL

    def noexec(path):
        if str(cache) in path:
            raise OSError(f"{path}: failed to map segment from shared object")
        return load(path)

    monkeypatch.setattr(ctypes, "CDLL", noexec)
    assert answer() == 42


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("harm", ["nothing can be loaded", "nothing can be written"])
def test_where_no_folder_will_do_the_controller_flies_interpreted(cache, monkeypatch, harm, capfd):
    if harm == "nothing can be loaded":
        monkeypatch.setattr(ctypes, "CDLL", no_space)
    else:
        monkeypatch.setattr(Path, "write_text", no_space)
    with pytest.raises(CompileError, match="cannot be written or loaded: No space left"):
        answer()
    capfd.readouterr()
    monkeypatch.setattr(library, "_warn_once", library._warn_once.__wrapped__)
    quick = ControllerConfig(horizon=3)
    x = quick.helix.initial_state(quick.tower, quick.vehicle)
    assert Controller(quick).step(0.0, x).status == "solved"
    said = capfd.readouterr().err.splitlines()
    assert [line for line in said if "interpreted" in line] == said[1:]
    assert len(said) == 2


FLY = """
import json
from gtmr_nmpc import Controller
from gtmr_sim import Scenario, fly
log = fly(Scenario(), Controller(), 0.25)
print(json.dumps([log.x.tolist(), log.u.tolist()]))
"""


def test_without_a_compiler_all_works_with_one_notice_and_the_same_answers(tmp_path):
    nothing = os.environ | {"CC": "no-such-compiler", "XDG_CACHE_HOME": str(tmp_path)}
    interpreted = subprocess.run(
        [sys.executable, "-c", FLY], check=True, capture_output=True, text=True, env=nothing
    )
    assert interpreted.stderr.count("\n") == 1
    assert "no C compiler found" in interpreted.stderr
    compiled = fly(Scenario(), Controller(), 0.25)
    x, u = json.loads(interpreted.stdout)
    np.testing.assert_allclose(compiled.x, x, atol=1e-9)
    np.testing.assert_allclose(compiled.u, u, atol=1e-9)


def test_the_compiled_plant_is_the_interpreted_one_bit_by_bit():
    vehicle = Vehicle.paper()
    x = Helix().initial_state(Tower(), vehicle)
    rng = np.random.default_rng(0)
    step = plant._plant_step(vehicle, 1e-3)
    compiled = plant._compiled(step)
    for _ in range(20):
        u, zeta, w_g = rng.normal(0, 300, 6), rng.normal(0, 0.1, 9), rng.normal(0, 0.3, 3)
        expected = np.concatenate((x, u, zeta, w_g, (x[0] ** 2 + x[1] ** 2,)))
        memory = expected.copy()
        plant._interpreted(step, expected, 25)
        compiled(memory, 25)
        np.testing.assert_array_equal(memory, expected)
        x = memory[: x.size]
