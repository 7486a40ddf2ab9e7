# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A small campaign, and what of campaigns can be compared."""

import pandas as pd

from gtmr_study.campaign.study import Study
from support.command_line import gtmr_process

TIMES = ["solve_ms_mean", "solve_ms_median", "solve_ms_p99"]
FIELDS = {"trials": 6, "seed": 5, "duration_s": 0.5}
STUDY = Study(**FIELDS)
ARGUMENTS = ("--trials", 6, "--seed", 5, "--duration", 0.5)
WORKERS = ("--workers", 2)


def flown_in(folder):
    """Fly it into a new folder; another summary goes beside that."""
    out = folder / "out"
    run = gtmr_process("campaign", *ARGUMENTS, *WORKERS, "--out", out, "--json", folder / "s.json")
    assert run.returncode == 0, run.stderr
    return out


def rows_of(folder):
    return pd.read_csv(folder / "trials.csv").drop(columns=TIMES)


def without_times(summary):
    return {mode: {k: v for k, v in s.items() if k != "solve_ms"} for mode, s in summary.items()}


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}
