# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The exported C controller and guard: pedantic C99, and the same commands as from Python."""

import re
import resource
import shutil
import subprocess
from pathlib import Path

import pytest

from gtmr_model import Vehicle
from gtmr_nmpc import ControllerConfig
from gtmr_study.export.guard import guard_files
from gtmr_study.export.project import export_c

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
SANITIZED = ["-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
FLIGHTS = ("flight.csv", "offset_free.csv", "guard.csv")
COMPILER = shutil.which("cc")
STACK_BYTES = 64 * 1024
"""What gtmr.h says is enough; here the program's own stack counts as well."""
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(COMPILER is None, reason="there is no C compiler, cc"),
]


def has_avx2():
    cpuinfo = Path("/proc/cpuinfo")
    return cpuinfo.exists() and "avx2" in cpuinfo.read_text(encoding="utf-8")


def build(folder, *flags):
    units = sorted(str(path) for path in folder.glob("*.c"))
    program = folder / "replay"
    command = [COMPILER, *STRICT, *flags, *units, "-o", str(program), "-lm"]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return program


def assert_repeats_the_flight(folder, program):
    run = subprocess.run(
        [program, *(folder / name for name in FLIGHTS)], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout + run.stderr
    controller, offset_free, guard = run.stdout.splitlines()
    assert controller.startswith("400 steps")
    assert offset_free.startswith("400 steps of offset_free")
    assert guard.startswith("800 steps of the guard")


@pytest.mark.parametrize(
    ("vehicle", "tightening", "mode", "flags"),
    [
        ("paper", "frozen", "robust", ["-O2"]),
        ("paper", "gradient", "robust", SANITIZED),
        # Late odometry and motors; registers twice as wide as those that every x86-64 has.
        ("octo", "frozen", "nominal", ["-O2", *(["-mavx2", "-mfma"] if has_avx2() else [])]),
    ],
)
def test_exported_controller_builds_strictly_and_repeats_the_flight(
    tmp_path, vehicle, tightening, mode, flags
):
    late = {"delay_s": 0.025, "motor_lag_s": 0.02} if vehicle == "octo" else {}
    config = ControllerConfig(
        vehicle=Vehicle.preset("vehicle", vehicle), tightening=tightening, **late
    )
    export_c(config, mode, tmp_path)
    assert_repeats_the_flight(tmp_path, build(tmp_path, *flags))


def test_exported_guard_is_as_slow_as_the_delay_and_lag_of_the_loop():
    def number(config, name):
        header = guard_files(config)["guard_parameters.h"]
        return float(re.search(rf"/\* {name} \*/ ([-.e0-9]+)", header)[1])

    late = ControllerConfig(delay_s=0.03, motor_lag_s=0.03)
    for name in ("rate_gain", "velocity_gain", "attitude_filter_rad_s"):
        assert number(late, name) == pytest.approx(0.5 * number(ControllerConfig(), name))
    assert number(late, "patience_s") == pytest.approx(
        number(ControllerConfig(), "patience_s") + 0.03
    )


@pytest.mark.skipif(shutil.which("cmake") is None, reason="there is no cmake")
def test_exported_project_builds_with_cmake_and_with_another_compiler(tmp_path):
    export_c(ControllerConfig(), "robust", tmp_path)
    compiler = shutil.which("clang") or COMPILER
    for command in (
        ["cmake", "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_C_COMPILER={compiler}"],
        ["cmake", "--build", tmp_path / "build", "--parallel", "2"],
    ):
        subprocess.run(command, check=True, capture_output=True, text=True)
    assert_repeats_the_flight(tmp_path, tmp_path / "build" / "replay")


def test_exported_sources_need_neither_heap_nor_python(tmp_path):
    export_c(ControllerConfig(), "robust", tmp_path)
    for path in tmp_path.glob("*.[ch]"):
        text = path.read_text()
        for word in ("malloc", "calloc", "realloc", "Python.h", "casadi.h", "#include <casadi"):
            assert word not in text, path.name


def test_exported_controller_needs_no_more_stack_than_stated_and_exports_prefixed_names(tmp_path):
    export_c(ControllerConfig(tightening="gradient"), "robust", tmp_path)
    assert f"{STACK_BYTES // 1024} kB" in (tmp_path / "gtmr.h").read_text()
    program = build(tmp_path, "-O2")
    names = subprocess.run(
        ["nm", "--extern-only", "--defined-only", "--format=posix", program],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    ours = {line.split()[0] for line in names.splitlines() if "@" not in line}
    assert {name for name in ours if not name.startswith(("gtmr_", "_", "main"))} <= {"data_start"}
    run = subprocess.run(
        [program, *(tmp_path / name for name in FLIGHTS)],
        capture_output=True,
        env={},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_STACK, (STACK_BYTES,) * 2),
    )
    assert run.returncode == 0


def test_replay_fails_when_a_command_of_controller_or_guard_differs(tmp_path):
    export_c(ControllerConfig(), "robust", tmp_path)
    program = build(tmp_path, "-O0")
    flights = [tmp_path / name for name in FLIGHTS]
    for flight in flights:
        whole = flight.read_text()
        rows = whole.splitlines()
        head, _, last = rows[100].rpartition(",")
        rows[100] = f"{head},{float(last) + 1e-3!r}"
        flight.write_text("\n".join(rows) + "\n")
        run = subprocess.run([program, *flights], capture_output=True, text=True)
        assert run.returncode == 1, flight.name
        flight.write_text(whole)
    assert subprocess.run([program, *flights], capture_output=True).returncode == 0
