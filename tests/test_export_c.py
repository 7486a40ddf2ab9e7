# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""The exported C controller: pedantic C99, and the same commands as from Python."""

import shutil
import subprocess

import pytest

from gtmr_model import Vehicle
from gtmr_nmpc import ControllerConfig
from gtmr_study.export_c import export_c

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2"]
COMPILER = shutil.which("cc")
pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler, cc")


@pytest.mark.parametrize(
    ("vehicle", "tightening", "mode"),
    [
        ("paper", "frozen", "robust"),
        ("paper", "gradient", "robust"),
        ("octo", "frozen", "nominal"),
    ],
)
def test_exported_controller_builds_strictly_and_repeats_the_flight(
    tmp_path, vehicle, tightening, mode
):
    config = ControllerConfig(vehicle=Vehicle.preset("vehicle", vehicle), tightening=tightening)
    export_c(config, mode, tmp_path)
    units = sorted(str(path) for path in tmp_path.glob("*.c"))
    program = tmp_path / "replay"
    build = [COMPILER, *STRICT, *units, "-o", str(program), "-lm"]
    subprocess.run(build, check=True, capture_output=True, text=True)
    run = subprocess.run([program, tmp_path / "flight.csv"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.startswith("400 steps")


def test_exported_sources_need_neither_heap_nor_python(tmp_path):
    export_c(ControllerConfig(), "robust", tmp_path)
    for path in tmp_path.glob("*.[ch]"):
        text = path.read_text()
        for word in ("malloc", "calloc", "realloc", "Python.h", "casadi.h", "#include <casadi"):
            assert word not in text, path.name


def test_replay_fails_when_a_command_differs(tmp_path):
    export_c(ControllerConfig(), "robust", tmp_path)
    flight = tmp_path / "flight.csv"
    rows = flight.read_text().splitlines()
    head, _, last = rows[100].rpartition(",")
    rows[100] = f"{head},{float(last) + 1e-3!r}"
    flight.write_text("\n".join(rows) + "\n")
    program = tmp_path / "replay"
    units = sorted(str(path) for path in tmp_path.glob("*.c"))
    subprocess.run([COMPILER, *STRICT, *units, "-o", str(program), "-lm"], check=True)
    run = subprocess.run([program, flight], capture_output=True, text=True)
    assert run.returncode == 1
