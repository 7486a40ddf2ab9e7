# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Faults, their promises and their count: the quick part of what ``gtmr faults`` tries."""

import json

import numpy as np
import pytest

from gtmr_model import Vehicle
from gtmr_model.vehicle import GRAVITY_M_S2
from gtmr_study.faults import campaign, catalogue
from gtmr_study.faults.campaign import broken, markdown, try_faults
from gtmr_study.faults.fault import Fault, OneByOne, Outcome
from gtmr_study.faults.vehicle import hover_without

pytestmark = pytest.mark.slow

FAULTS = catalogue.faults()
TRIED = (
    "bad-network",
    "commands-beyond-limits",
    "commands-from-future",
    "commands-from-past",
    "commands-gap-3",
    "commands-late",
    "commands-lost-50",
    "commands-nan",
    "nmpc-killed",
    "nmpc-restarted",
    "odometry-from-past",
    "odometry-gap",
    "odometry-late-100",
    "odometry-late-75",
    "odometry-nan",
    "odometry-stuck",
    "solver-failing",
    "start-inverted",
    "start-towards",
    "world-reset",
)
"""Faults of the loop that are tried here, each as often as `TRIES` says."""
TRIES = range(3)


@pytest.mark.parametrize("name", TRIED)
def test_what_is_promised_in_the_loop_is_kept(name):
    outcomes = list(FAULTS[name].outcomes(TRIES))

    assert [o.why for o in outcomes if not o.held] == []


@pytest.mark.parametrize("name", [f.name for f in FAULTS.values() if f.place == "files"])
def test_what_is_promised_of_files_is_kept(name):
    outcomes = list(FAULTS[name].outcomes(range(20)))

    assert [o.why for o in outcomes if not o.held] == []


def test_there_are_faults_and_tries_enough():
    tries = sum(fault.tries for fault in FAULTS.values() if fault.place == "loop")

    assert len(FAULTS) >= 25
    assert tries >= 10_000
    assert all(fault.promise and 0 < fault.quick <= fault.tries for fault in FAULTS.values())


def test_a_try_is_the_same_wherever_it_is_made():
    names = ["commands-lost-30", "odometry-jump"]
    here = [list(FAULTS[name].outcomes(range(FAULTS[name].quick))) for name in names]

    rows = try_faults(catalogue.faults, names, quick=True)

    assert [row["worst_clearance_m"] for row in rows] == [
        min(o.clearance_m for o in outcomes) for outcomes in here
    ]


def test_without_a_rotor_the_paper_s_vehicle_cannot_hover_and_one_with_cant_can():
    """As Michieletto, Ryll and Franchi found (2018): the tilt about the arm is not enough."""
    paper = Vehicle.paper()
    canted = [rotor.model_copy(update={"cant_deg": 25.0}) for rotor in paper.rotors]
    light = {"mass_kg": 0.8, "min_rotor_speed_hz": 5.0, "rotors": tuple(canted)}
    other = paper.model_copy(update=light)

    assert np.linalg.matrix_rank(np.delete(paper.allocation, 0, axis=1)) == 5
    assert [hover_without(paper, k) for k in range(6)] == [None] * 6
    tilt, speeds = hover_without(other, 0)
    wrench = np.delete(other.allocation, 0, axis=1) @ speeds**2
    assert np.linalg.norm(wrench[:3]) == pytest.approx(other.mass_kg * GRAVITY_M_S2)
    assert wrench[3:] == pytest.approx(np.zeros(3), abs=1e-9)
    assert 0.05 < tilt < 0.5


def row(held, always=True):
    (made,) = try_faults(
        lambda: {
            "x": Fault(
                "x",
                "stays",
                "nodes",
                4,
                4,
                OneByOne(lambda rng, left=[True] * held: Outcome(bool(left and left.pop()), 0.2)),
                always,
            )
        },
        ["x"],
        quick=False,
    )
    return made


def test_the_row_of_a_fault_counts_what_was_held():
    made = row(held=3)

    assert (made["tried"], made["held"], made["worst_clearance_m"]) == (4, 3, 0.2)
    assert made["held_95"][0] < 0.75 < made["held_95"][1]
    assert "| x | stays | 3 of 4 |" in markdown([made])


@pytest.mark.parametrize(("held", "always", "code"), [(4, True, 0), (3, True, 1), (0, False, 0)])
def test_the_command_fails_when_a_promise_is_broken(held, always, code, gtmr, monkeypatch):
    made = row(held, always)
    monkeypatch.setattr(campaign, "try_faults", lambda *_: [made])

    ended = gtmr("faults", "commands-gap-3")

    assert ended.returncode == code, ended.stderr
    assert ("x: not held 1 of 4" in ended.stderr) == bool(code)
    assert broken([made]) == ["x"] * code


def test_the_command_writes_its_rows(gtmr, tmp_path):
    ended = gtmr("faults", "--quick", "paths-hostile", "--json", tmp_path / "f.json")

    (row,) = json.loads((tmp_path / "f.json").read_text())
    keys = {"fault", "promise", "tried", "held", "worst_clearance_m", "recovery_s"}
    assert ended.returncode == 0, ended.stderr
    assert keys <= set(row)
    assert row["held"] == row["tried"] > 0


def test_a_fault_that_there_is_not_is_refused(refused):
    assert "FAULT = 'nonsense'" in refused("faults", "nonsense")
