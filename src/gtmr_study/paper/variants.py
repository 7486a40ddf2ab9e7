# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The same trials with one thing changed: other readings of the paper, and what it leaves out."""

import re
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gtmr_nmpc import PAPER_MODES
from gtmr_study.campaign import cluster
from gtmr_study.campaign.study import Study
from gtmr_study.campaign.summary import summarise
from gtmr_study.campaign.trials_file import in_order, open_campaign, read_trials
from gtmr_study.paper.claims import distances
from gtmr_study.paper.margin_budget import margin_budget, unit_slips
from gtmr_study.paper.unreported import UNREPORTED, values_of, with_values

AS_IT_IS = "as it is"
"""Name of the variant in which nothing is changed."""


@dataclass(frozen=True)
class Variant:
    """A study in which one thing is changed."""

    name: str
    """What is changed, with its value and unit."""
    parameter: str
    """Name in `UNREPORTED` of the value that is changed; empty if it is something else."""
    study: Study
    """The study."""

    @property
    def folder(self) -> str:
        """Name of the folder of its flights, in plain letters."""
        name = re.sub(r"[^a-z0-9.]+", "-", self.name.replace("ε", "eps").lower())
        return name.strip("-")


def variants(study: Study, trials: int, duration_s: float) -> list[Variant]:
    """Change one thing at a time; mismatch and gusts of a trial are the same in every variant.

    First the one as it is, then other readings of the paper's formulas and bounds, then every
    value of `UNREPORTED` that the study does not have already.
    """
    base = study.model_copy(
        update={
            # The world stays as it is where the controller is given another box.
            "uncertainty": study.true_uncertainty,
            "modes": PAPER_MODES,
            "trials": trials,
            "duration_s": duration_s,
        }
    )
    made = [Variant(AS_IT_IS, "", base)]
    for name, controller in unit_slips(base.controller).items():
        made.append(Variant(name, "", base.model_copy(update={"controller": controller})))
    there = values_of(base)
    for parameter, known in UNREPORTED.items():
        for value in known.tried:
            if value != there[parameter]:
                name = f"{known.label} = {value:g} {known.unit}"
                made.append(Variant(name, parameter, with_values({parameter: value}, base)))
    return made


def fly_variants(
    workers: Executor,
    made: Sequence[Variant],
    folder: Path,
    on_progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """Fly what is missing of variants, each a campaign in a folder of its own in ``folder``.

    A row has ``name``, ``parameter``, ``margins_m`` (see `margin_budget`), ``summary`` (see
    `summarise`) and ``distance`` to the paper's ``nominal`` rows and to ``both``. Errors are those
    of `open_campaign`.
    """
    rows = []
    for k, variant in enumerate(made):
        own = folder / variant.folder
        # Before the workers, which would compile another vehicle each for itself.
        margins = margin_budget(variant.study.controller)
        with open_campaign("--out", own, variant.study) as file:
            missing = [flight for flight in variant.study.flights() if flight not in file.done]
            for flown in cluster.fly_on(workers, variant.study, missing):
                file.append(flown)
            file.sort(in_order)
            summary = summarise(read_trials(own))
        rows.append(
            {
                "name": variant.name,
                "parameter": variant.parameter,
                "margins_m": margins,
                "summary": summary,
                "distance": distances(summary),
            }
        )
        on_progress(k + 1, len(made))
    return rows
