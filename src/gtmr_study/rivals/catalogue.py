# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Who flies in the arena, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from gtmr_nmpc import MODES, Controller, ControllerConfig, Mode
from gtmr_sim import Scenario, StepController
from gtmr_study.rivals.feedback.indi import INDI
from gtmr_study.rivals.feedback.lqr import LQR
from gtmr_study.rivals.feedback.pid import PID
from gtmr_study.rivals.fixed_margin import FIXED_MARGIN
from gtmr_study.rivals.oracle import ORACLE
from gtmr_study.rivals.robust_mpc.ellipsoid import ELLIPSOID, ELLIPSOID_FEEDBACK
from gtmr_study.rivals.robust_mpc.scenario_tree import SCENARIO_TREE
from gtmr_study.rivals.robust_mpc.tube import TUBE

Maker = Callable[[ControllerConfig, Scenario], StepController]
"""Makes a controller for one flight, from what it may know. The scenario is for an oracle alone:
nobody else may look at its zeta and its gusts."""


@dataclass(frozen=True)
class Rival:
    """A controller and what a reader must know to compare it."""

    family: str
    """What it is, in one line."""
    make: Maker
    """Makes it."""
    trials: float = field(default=1.0, kw_only=True)
    """Share of the trials that it flies [-]: less for those whose step takes long."""


SLOWER, SLOW, SLOWEST = 0.2, 0.04, 0.006
"""Shares of those whose step takes some 0.1 ms, 0.5 ms and 10 ms."""


def _mode(mode: Mode) -> Maker:
    return lambda config, _: Controller(config, mode)


def _with_gradient(config: ControllerConfig, _: Scenario) -> StepController:
    """Make the paper's robust controller as eq. (15) reads: its margins depend on the plan.

    It assumes what `robust` does, and knows besides how its margins change with the plan, so that
    it may also choose plans that are less sensitive. Nothing of it is tuned, as the paper tunes
    nothing; the second-order sensitivities make a step dearer. Its friends say that a frozen
    margin is not the paper's: so both fly.
    """
    return Controller(config.model_copy(update={"tightening": "gradient"}), "robust")


FAMILIES: dict[Mode, str] = {
    "nominal": "NMPC without a margin (the paper's)",
    "robust": "NMPC with first-order margins (the paper's)",
    "offset_free": "NMPC with a disturbance observer and margins of its closed loop",
}

RIVALS: dict[str, Rival] = {
    "lqr": Rival("LQR about hover with a disturbance observer", LQR, trials=SLOWER),
    "pid": Rival("cascade of PIDs, geometric attitude control", PID, trials=SLOWER),
    "indi": Rival("incremental inversion on filtered accelerations", INDI, trials=SLOWER),
    **{mode: Rival(FAMILIES[mode], _mode(mode)) for mode in MODES},
    "fixed_margin": Rival("nominal NMPC with a constant margin", FIXED_MARGIN, trials=SLOWER),
    "robust_gradient": Rival(
        "the paper's, its margins in the QP with gradient", _with_gradient, trials=SLOWER
    ),
    "ellipsoid": Rival("NMPC with ellipsoids along its plan (zoRO)", ELLIPSOID, trials=SLOW),
    "ellipsoid_feedback": Rival(
        "the same with feedback in its tube", ELLIPSOID_FEEDBACK, trials=SLOW
    ),
    "tube": Rival("plan of the nominal vehicle and feedback in a rigid tube", TUBE, trials=SLOWER),
    "scenario_tree": Rival(
        "multi-stage NMPC over winds in and out", SCENARIO_TREE, trials=SLOWEST
    ),
    "oracle": Rival("NMPC that knows all but the future: the limit", ORACLE, trials=SLOWER),
}
"""Every controller of the arena."""
