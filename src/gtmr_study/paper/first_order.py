# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How good is first order? True clearance perturbations of flown plans against the margins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from gtmr_model import N_ZETA, Tower, Vehicle
from gtmr_model.dynamics import discrete_step, one_at_a_time, symbols
from gtmr_monitor.report.drawing import new_figure
from gtmr_nmpc import Controller, Solution
from gtmr_sim import fly
from gtmr_study.campaign.study import Study

Array = NDArray[np.float64]

EVERY_S = 0.5
"""Time between two plans that are looked at; a horizon, so that they do not overlap [s]."""
VERTICES_EVERY = 5
"""Of every which trial the first plan is also tried in the worst cases, all 512 vertices of the
box among them."""
PARTS = ("parametric", "gust", "both")


@dataclass(frozen=True)
class Perturbations:
    """By how much the clearance of n plans changes when flown open loop in the true world.

    The reference is the plan flown with the nominal model, without gusts, from the same state.
    Changes are those of y = d_min - d_T: above zero is towards the tower [m]. Stages are 0 to N.
    """

    parametric: Array
    """With the true zeta, without gusts, shape (n, N + 1)."""
    gust: Array
    """With zeta = 0 and the gusts of the flight, shape (n, N + 1)."""
    both: Array
    """With both, shape (n, N + 1)."""
    alpha_p: Array
    """Parametric margin of the plan, eq. (12), without eps_s [m], shape (n, N + 1)."""
    alpha_g: Array
    """Gust margin, eq. (13) [m], shape (n, N + 1)."""
    worst_parametric: Array
    """Largest change at any vertex of the box over alpha_p [-], shape (v, N); stages 1 to N."""
    worst_gust: Array
    """Change under the full gust held towards the tower, over alpha_g [-], shape (v, N)."""

    @classmethod
    def join(cls, parts: Sequence[Perturbations]) -> Perturbations:
        """Put the plans of many flights together."""
        return cls(
            *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls))
        )

    def ratio(self, part: str) -> Array:
        """Size of a change over its margin [-], shape (n, N), stages 1 to N; exceeded above 1."""
        change: Array = getattr(self, part)
        bound = {"parametric": self.alpha_p, "gust": self.alpha_g}.get(
            part, self.alpha_p + self.alpha_g
        )
        ratio: Array = np.abs(change[:, 1:]) / bound[:, 1:]
        return ratio


class _Recorder:
    """Passes a controller's plans on and keeps some of them."""

    def __init__(self, controller: Controller, every: int) -> None:
        self._controller, self._every = controller, every
        self.steps = 0
        self.kept: list[tuple[int, Array, Solution]] = []

    def step(self, t: float, x: Array) -> Solution:
        solution = self._controller.step(t, x)
        # The first plan starts cold: its margins are those of a vehicle that stands still.
        if self.steps and self.steps % self._every == 0:
            self.kept.append((self.steps, np.array(x), solution))
        self.steps += 1
        return solution


def perturbations(study: Study, trials: Sequence[int]) -> Perturbations:
    """Fly trials with the robust controller and try its plans open loop.

    The study's duration must be longer than two horizons.
    """
    return Perturbations.join([_of_trial(study, trial) for trial in trials])


def _of_trial(study: Study, trial: int) -> Perturbations:
    config, scenario = study.controller, study.scenario(trial)
    period, horizon = config.sampling_time_s, config.horizon
    recorder = _Recorder(Controller(config, "robust"), round(EVERY_S / period))
    log = fly(scenario, recorder, study.duration_s, period)
    kept = [plan for plan in recorder.kept if plan[0] + horizon <= len(log.t)]

    x = np.array([x for _, x, _ in kept])
    u = np.array([solution.u_plan for *_, solution in kept])
    gusts = np.array([log.w_g[k : k + horizon] for k, *_ in kept])
    alpha_p = np.array([solution.alpha_p - solution.eps_s for *_, solution in kept])
    alpha_g = np.array([solution.alpha_g for *_, solution in kept])
    y = partial(_residual, config.vehicle, config.tower, period)
    zeta, calm = scenario.zeta_array, np.zeros(3)
    nominal = y(x, u, np.zeros(N_ZETA), calm)

    worst_p, worst_g = [], []
    vertices = config.uncertainty.vertices()
    for plan in (0,) if kept and trial % VERTICES_EVERY == 0 else ():
        alone = slice(plan, plan + 1)
        many_x, many_u = (np.repeat(v[alone], len(vertices), axis=0) for v in (x, u))
        change = y(many_x, many_u, vertices, calm) - nominal[alone]
        worst_p.append(change[:, 1:].max(axis=0) / alpha_p[plan, 1:])
        inward = -x[plan, :3] * [1.0, 1.0, 0.0] / np.hypot(x[plan, 0], x[plan, 1])
        gust = config.uncertainty.gust_n * inward
        change = y(x[alone], u[alone], np.zeros(N_ZETA), gust) - nominal[alone]
        worst_g.append(change[0, 1:] / alpha_g[plan, 1:])
    return Perturbations(
        parametric=y(x, u, zeta, calm) - nominal,
        gust=y(x, u, np.zeros(N_ZETA), gusts) - nominal,
        both=y(x, u, zeta, gusts) - nominal,
        alpha_p=alpha_p,
        alpha_g=alpha_g,
        worst_parametric=np.array(worst_p).reshape(-1, horizon),
        worst_gust=np.array(worst_g).reshape(-1, horizon),
    )


def _residual(
    vehicle: Vehicle,
    tower: Tower,
    period_s: float,
    x: Array,
    u: Array,
    zeta: ArrayLike,
    w_g: ArrayLike,
) -> Array:
    """Fly n plans open loop; y at every stage [m], shape (n, N + 1)."""
    n, horizon = u.shape[:2]
    step = _step(vehicle, period_s).map(n)
    held = np.broadcast_to(zeta, (n, N_ZETA)).T
    gusts = np.broadcast_to(w_g, (n, horizon, 3))
    states = x.T
    y = [tower.residual(x)]
    for k in range(horizon):
        states = np.asarray(step(states, u[:, k].T, held, gusts[:, k].T))
        y.append(tower.residual(states.T))
    return np.stack(y, axis=1)


@lru_cache(maxsize=4)
@one_at_a_time
def _step(vehicle: Vehicle, period_s: float) -> ca.Function:
    x, u, zeta, w_g = symbols(vehicle)
    x_next = discrete_step(x, u, zeta, w_g, vehicle, period_s)
    return ca.Function("step", [x, u, zeta, w_g], [x_next])


def quality(found: Perturbations) -> dict[str, Any]:
    """Boil perturbations down to figures by stage, 1 to N [-].

    ``plans``; for ``parametric``, ``gust`` and ``both``: ``exceeded``, the share of plans whose
    change is larger than the margin, and ``median``, ``p99`` and ``max`` of change / margin; for
    ``worst_parametric`` and ``worst_gust``: median, least and largest ratio in the worst case.
    """
    result: dict[str, Any] = {"plans": len(found.parametric)}
    for part in PARTS:
        ratio = found.ratio(part)
        result[part] = {
            "exceeded": (ratio > 1.0).mean(axis=0).tolist(),
            "median": np.median(ratio, axis=0).tolist(),
            "p99": np.percentile(ratio, 99, axis=0).tolist(),
            "max": ratio.max(axis=0).tolist(),
        }
    for part in ("worst_parametric", "worst_gust"):
        ratio = getattr(found, part)
        result[part] = {
            "min": ratio.min(axis=0).tolist(),
            "median": np.median(ratio, axis=0).tolist(),
            "max": ratio.max(axis=0).tolist(),
        }
    return result


def draw(figures: dict[str, Any]) -> Figure:
    """Draw by stage how much of each margin is used."""
    figure = new_figure(9.0, 3.6)
    titles = {"parametric": "Parametric", "gust": "Gust", "both": "Both"}
    panels = figure.subplots(1, 3, sharey=True)
    for axes, (part, title) in zip(panels, titles.items(), strict=True):
        shown = figures[part]
        stages = np.arange(1, len(shown["max"]) + 1)
        for key, dash in (("max", "-"), ("p99", "--"), ("median", ":")):
            axes.plot(stages, shown[key], dash, color="#0072B2", label=f"true flights, {key}")
        worst = figures.get(f"worst_{part}")
        if worst is not None:
            axes.fill_between(
                stages, worst["min"], worst["max"], color="#D55E00", alpha=0.4, linewidth=0.0
            )
            axes.plot(stages, worst["median"], color="#D55E00", label="worst case of the bounds")
        axes.axhline(1.0, color="#1a1a1a", linewidth=1.2, linestyle=(0, (4, 2)))
        axes.set(title=title, xlabel="stage i")
        axes.set_ylim(bottom=0.0)
    panels[0].set_ylabel("clearance change / margin [-]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure
