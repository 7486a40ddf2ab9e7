# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is kept of a flight: its figures, its table, its picture, and its file."""

import io
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from gtmr_monitor.residual import residual_statistics, solve_statistics
from gtmr_nmpc import Controller
from gtmr_sim import FlightFileError, FlightLog, Scenario, fly


class Holds:
    """Holds all rotor speeds and tells nothing."""

    def step(self, t, x):
        return np.zeros(len(x) - 12)


@pytest.fixture(scope="module")
def log():
    return fly(Scenario(seed=3).sampled(), Controller(mode="nominal"), 1.0)


@pytest.fixture(scope="module")
def written(log, tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "flight.npz"
    log.save(path)
    return path


def test_its_figures_are_those_of_reports(log):
    summary, d_min = log.summary(), log.scenario.tower.min_clearance_m
    expected = residual_statistics(d_min - log.d_T, d_min)
    assert {key: summary[key] for key in expected} == expected
    assert summary["solve_ms"] == solve_statistics(log.solve_ms)


def test_errors_are_measured_from_the_reference(log):
    rate = 0.5 / 1.35
    angle = rate * log.t
    helix = np.stack([1.35 * np.cos(angle), 1.35 * np.sin(angle), 2.0 + 0.05 * log.t], axis=1)
    total = np.linalg.norm(log.x[:, :3] - helix, axis=1)
    radial = np.hypot(log.x[:, 0], log.x[:, 1]) - 1.35
    summary = log.summary()
    assert summary["tracking_rms_m"] == pytest.approx(np.sqrt((total**2).mean()), abs=1e-12)
    assert summary["radial_rms_m"] == pytest.approx(np.sqrt((radial**2).mean()), abs=1e-12)
    assert summary["radial_rms_m"] < summary["tracking_rms_m"]


def test_a_flight_that_diverged_has_no_figures(log):
    lost = FlightLog(**{**vars(log), "d_T": np.full_like(log.d_T, np.nan)})
    with pytest.raises(ValueError, match="diverged"):
        lost.summary()


def test_it_says_which_flight_it_is_in_one_line(log):
    least = f"{log.least_clearance_m:.3f}"
    assert repr(log) == f"FlightLog(nominal, 1 s in 40 steps, least clearance {least} m)"


def test_its_table_has_a_row_a_sampling_time_and_columns_with_units(log):
    table = log.to_pandas()
    assert table.index.name == "t_s"
    np.testing.assert_array_equal(table.index, log.t)
    np.testing.assert_array_equal(table["p_z_m"], log.x[:, 2])
    np.testing.assert_array_equal(table["omega_x_rad_s"], log.x[:, 9])
    np.testing.assert_array_equal(table["u_5_hz_s"], log.u[:, 5])
    np.testing.assert_array_equal(table["alpha_g_m"], log.alpha_g.max(axis=1))


def test_what_a_controller_does_not_tell_is_in_no_column():
    log = fly(Scenario(), Holds(), 0.1)
    assert log.mode == "Holds"
    assert not {"alpha_p_m", "slack_m", "failed"} & set(log.to_pandas())
    assert log.summary()["max_slack_m"] is None
    assert log.summary()["softened_steps"] is None


def test_its_picture_has_the_clearance_and_the_limits(log, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    axes = log.plot()
    assert [each.get_ylabel() for each in axes] == [
        "clearance [m]", "tracking error [m]", "margins [m]", "rotor speed [Hz]"
    ]  # fmt: skip
    np.testing.assert_array_equal(axes[0].lines[0].get_ydata(), log.d_T)
    d_min = axes[0].lines[3].get_ydata()
    assert set(d_min) == {log.scenario.tower.min_clearance_m}
    axes[0].figure.savefig(io.BytesIO())


def test_flying_needs_neither_pandas_nor_matplotlib():
    script = (
        "import sys\nfrom gtmr_nmpc import Controller\nfrom gtmr_sim import Scenario, fly\n"
        "fly(Scenario(), Controller(), 0.1).summary()\n"
        "print({'pandas', 'matplotlib'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.strip() == "set()", done.stderr


@pytest.mark.parametrize("pilot", [Controller(), Holds()], ids=["the suite's", "another"])
def test_what_is_read_is_what_was_written(pilot, tmp_path):
    log, path = fly(Scenario(seed=5).sampled(), pilot, 0.1), tmp_path / "flight.npz"
    log.save(path)
    again = FlightLog.load(path)
    assert again.scenario == log.scenario
    assert again.summary() == log.summary()
    for name, value in vars(log).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(again, name), value, name)


def changed(**fields):
    """Make a change of the arrays in a file; None takes one away."""

    def change(path):
        with np.load(path) as file:
            data = dict(file) | fields
        np.savez(path, **{name: value for name, value in data.items() if value is not None})

    return change


def longer(name):
    def change(path):
        with np.load(path) as file:
            data = dict(file)
        data[name] = np.concatenate([data[name], data[name][-1:]])
        np.savez(path, **data)

    return change


def one_array(path):
    with path.open("wb") as file:
        np.save(file, np.zeros(3))


def torn(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flipped(path):
    with zipfile.ZipFile(path) as file:
        place = file.getinfo("x.npy").header_offset + 200
    content = bytearray(path.read_bytes())
    content[place] ^= 0xFF
    path.write_bytes(bytes(content))


BROKEN = {
    "nothing": (lambda path: path.unlink(), "No such file"),
    "a folder": (lambda path: (path.unlink(), path.mkdir()), "Is a directory"),
    "empty": (lambda path: path.write_bytes(b""), "is no npz file"),
    "text": (lambda path: path.write_text("t, x, u\n"), "is no npz file"),
    "one array": (one_array, "is no npz file"),
    "torn": (torn, "is no npz file"),
    "a flipped byte": (flipped, "is no npz file"),
    "somebody else's": (lambda path: np.savez(path, a=np.zeros(3)), "there is no t"),
    "an older one": (changed(scenario=None), "there is no scenario"),
    "objects": (changed(t=np.array([{}], dtype=object)), "is no npz file"),
    "a scenario that is none": (changed(scenario=np.array("{}]")), "scenario is none"),
    "a scenario of wrong fields": (changed(scenario=np.array('{"seed": -1}')), "seed = -1"),
    "rows of another length": (longer("u"), "u has shape (41, 6)"),
    "another vehicle's rows": (changed(x=np.zeros((40, 20))), "x has shape (40, 20)"),
    "text in place of numbers": (changed(d_T=np.array(["a"] * 40)), "d_T does not hold numbers"),
    "no rows": (changed(t=np.zeros(0)), "t has no rows"),
    "times in disorder": (changed(t=np.zeros(40)), "t is not a row of sampling times"),
    "no number": (changed(least_clearance_m=np.array("a")), "least_clearance_m is no number"),
    "no name": (changed(mode=np.array(1.0)), "mode is no text"),
    "another flight's clearance": (changed(d_T=np.zeros(40)), "d_T is not the clearance of x"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_or_foreign_file_is_refused_in_one_line(case, written, tmp_path):
    break_it, told = BROKEN[case]
    path = tmp_path / "flight.npz"
    path.write_bytes(written.read_bytes())
    break_it(path)
    with pytest.raises(FlightFileError) as refused:
        FlightLog.load(path)
    said = str(refused.value)
    assert said.startswith(f"{path}: ")
    assert told in said
    assert "\n" not in said
