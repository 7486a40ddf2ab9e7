# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A small campaign as in a notebook: both modes on six random worlds, a table and a figure.

Another folder for the figure than a temporary one: python examples/08_campaign.py DIR
Many trials go faster on all processors, and can be resumed: gtmr campaign --out DIR
"""

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from gtmr_study.campaign.study import Study
from gtmr_study.campaign.summary import summarise
from gtmr_study.campaign.trial import fly_trials

plt.switch_backend("agg")  # draws to files, without a display; a notebook leaves this out
folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
folder.mkdir(parents=True, exist_ok=True)

# Every trial has its own gusts and true mismatch; both modes fly the same ones.
study = Study(trials=6, duration_s=4.0, seed=1)
rows = pd.DataFrame(fly_trials(study, study.flights()))
# A flight that fails does not end the others: its row says why.
print(f"flown: {(rows['status'] == 'flown').sum()} of {len(rows)}")

clearance = rows.pivot(index="trial", columns="mode", values="min_clearance_m")
print(f"\nleast clearance [m]\n{clearance.round(3)}\n")
for mode, figures in summarise(rows).items():
    low, high = figures["violation_rate_95"]
    print(
        f"{mode}: {figures['violations']} of {figures['trials']} trials came too close, "
        f"a rate between {low:.0%} and {high:.0%} with 95 % confidence"
    )

axes = clearance.plot.bar(ylabel="least clearance [m]", rot=0)
axes.axhline(study.controller.tower.min_clearance_m, color="black", linestyle="--")
axes.figure.savefig(folder / "least_clearance.png")
print(f"figure: {folder / 'least_clearance.png'}")
