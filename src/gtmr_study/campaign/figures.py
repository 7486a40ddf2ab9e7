# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The figures of a campaign: what its trials say, drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from gtmr_monitor.report import look
from gtmr_monitor.report.drawing import new_figure, save
from gtmr_study.campaign.study import Study
from gtmr_study.campaign.summary import (
    LEAST_TRIALS_FOR_SHARES,
    SHARE_HALF_WIDTH,
    channel_shares,
    summarise,
    wilson_interval,
)
from gtmr_study.campaign.trial import FLOWN
from gtmr_study.campaign.trials_file import read_study, read_trials


@dataclass(frozen=True)
class Campaign:
    """The results of a campaign."""

    name: str
    """What to call it."""
    study: Study
    """What was flown."""
    trials: pd.DataFrame
    """The rows of trials.csv."""

    @classmethod
    def read(cls, folder: Path) -> Campaign:
        """Read a campaign's folder, finished or not; InputError if it holds none."""
        return cls(folder.resolve().name, read_study(folder), read_trials(folder))

    @property
    def flown(self) -> dict[str, pd.DataFrame]:
        """Rows by mode, of the trials that did not raise."""
        rows = self.trials[self.trials["status"] == FLOWN]
        return {str(mode): group for mode, group in rows.groupby("mode", sort=False)}

    @property
    def summary(self) -> dict[str, dict[str, Any]]:
        """The figures, see `summarise`."""
        return summarise(self.trials)


def mode_colour(mode: str) -> str:
    """Colour of a mode, or of an own controller."""
    return look.MODE_COLOURS.get(mode, look.OTHER_COLOUR)


def residual(campaign: Campaign) -> Figure:
    """Draw the residual pooled over all trials as box plots, as in Fig. 2."""
    figure = new_figure(5.2, 4.2)
    axes = figure.subplots()
    summary = {mode: campaign.summary[mode]["residual_m"] for mode in campaign.flown}
    draw_boxes(axes, list(summary.values()), [mode_colour(mode) for mode in summary])
    axes.set_xticks(range(1, len(summary) + 1), [str(mode) for mode in summary])
    axes.set(
        ylabel="s = $d_{min} - d_T$ [m]", title="Clearance residual, all instants of all trials"
    )
    return figure


def draw_boxes(axes: Any, boxes: list[dict[str, float]], colours: list[str]) -> None:
    """Draw box plots from five numbers each [m], with the safety line at zero.

    A box has ``min``, ``q1``, ``median``, ``q3`` and ``max``; the whiskers go to the extremes.
    """
    keys = {"whislo": "min", "q1": "q1", "med": "median", "q3": "q3", "whishi": "max"}
    drawn = axes.bxp(
        [{name: box[key] for name, key in keys.items()} for box in boxes],
        showfliers=False,
        widths=0.45,
        patch_artist=True,
    )
    for k, colour in enumerate(colours):
        drawn["boxes"][k].set(facecolor=colour + "40", edgecolor=colour)
        drawn["medians"][k].set(color=colour, linewidth=2.0)
        for line in drawn["whiskers"][2 * k : 2 * k + 2] + drawn["caps"][2 * k : 2 * k + 2]:
            line.set(color=colour)
    axes.axhline(0.0, color=look.LIMIT, linestyle=(0, (4, 2)), linewidth=1.2)
    axes.annotate(
        "violated above 0", (1.0, 0.0), (0.0, 3.0), xycoords=("axes fraction", "data"),
        textcoords="offset points", ha="right", fontsize=8,
    )  # fmt: skip
    highest = max(0.0, *(box["max"] for box in boxes))
    axes.set_ylim(top=max(highest + 0.03, 0.04))


def least_clearance(campaign: Campaign) -> Figure:
    """Draw how the trials' least clearance is distributed."""
    figure = new_figure(6.4, 4.2)
    axes = figure.subplots()
    for mode, rows in campaign.flown.items():
        _distribution(axes, rows["min_clearance_m"], color=mode_colour(mode), label=mode)
    d_min = campaign.study.controller.tower.min_clearance_m
    axes.axvline(d_min, color=look.LIMIT, linestyle=(0, (4, 2)), linewidth=1.2)
    axes.annotate(
        "$d_{min}$", (d_min, 1.0), (3.0, -2.0), xycoords=("data", "axes fraction"),
        textcoords="offset points", va="top",
    )  # fmt: skip
    axes.set(
        xlabel="least clearance of a trial [m]", ylabel="share of trials at or below",
        ylim=(0.0, 1.02), title="Least clearance",
    )  # fmt: skip
    axes.legend(loc="lower right")
    return figure


def _distribution(axes: Any, column: pd.Series, **pen: Any) -> None:
    values = np.sort(column.to_numpy(float))
    axes.step(values, np.arange(1, values.size + 1) / values.size, where="post", **pen)


def violations(campaign: Campaign) -> Figure:
    """Draw the share of trials with a violation, with its 95 % interval."""
    figure = new_figure(6.4, 1.1 + 0.5 * len(campaign.flown))
    axes = figure.subplots()
    modes = list(campaign.flown)
    for k, mode in enumerate(modes):
        s = campaign.summary[mode]
        low, high = (100.0 * bound for bound in wilson_interval(s["violations"], s["trials"]))
        rate = 100.0 * s["violation_rate"]
        colour = mode_colour(mode)
        axes.plot([low, high], [k, k], color=colour, linewidth=2.5, solid_capstyle="butt")
        axes.plot(rate, k, "o", color=colour, markersize=6)
        axes.annotate(
            f"{s['violations']} of {s['trials']}: {low:.1f} to {high:.1f} %", (high, k),
            (8.0, 0.0), textcoords="offset points", va="center", fontsize=8,
        )  # fmt: skip
    axes.set_yticks(range(len(modes)), modes)
    axes.set(
        xlim=(-2.0, 130.0), ylim=(len(modes) - 0.5, -0.5), xlabel="share of trials [%]",
        xticks=range(0, 101, 20), title="Trials with a violation, Wilson interval of 95 %",
    )  # fmt: skip
    return figure


def channels(campaign: Campaign) -> Figure:
    """Draw which channels drive the least clearance, with their 95 % intervals."""
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    shares = {mode: 100.0 * channel_shares(rows) for mode, rows in campaign.flown.items()}
    order = next(iter(shares.values())).index[::-1]
    height = 0.8 / len(shares)
    for k, (mode, found) in enumerate(shares.items()):
        place = np.arange(len(order)) + height * (0.5 * (len(shares) - 1) - k)
        share, low, high = (found[column].reindex(order) for column in ("share", "low", "high"))
        axes.barh(
            place, share, height, color=mode_colour(mode), label=mode,
            xerr=(share - low, high - share),
            error_kw={"ecolor": look.INK, "elinewidth": 1.0, "capsize": 2.0},
        )  # fmt: skip
    axes.set_yticks(range(len(order)), [look.MARGIN_LABELS[name] for name in order])
    axes.set(
        xlabel="share of the variance that the channel alone explains [%]", xlim=(0.0, 100.0),
        title="What drives the least clearance of a trial",
    )  # fmt: skip
    axes.grid(visible=False, axis="y")
    axes.legend(loc="lower right")
    return figure


def why_no_channels(campaign: Campaign) -> str:
    """Say in one sentence why `channels` would show nothing to rely on; empty if it would not."""
    fewest = min(map(len, campaign.flown.values()), default=0)
    if fewest < LEAST_TRIALS_FOR_SHARES:
        return (
            f"What drives the least clearance cannot be told from {fewest} trials a mode: below "
            f"{LEAST_TRIALS_FOR_SHARES} a channel's share of the variance is known to no better "
            f"than ±{100.0 * SHARE_HALF_WIDTH:g} %."
        )
    if any(channel_shares(rows).empty for rows in campaign.flown.values()):
        return "What drives the least clearance cannot be told: it, or every channel, is constant."
    return ""


def solve_times(campaign: Campaign) -> Figure:
    """Draw the trials' solve times."""
    figure = new_figure(6.4, 3.4)
    axes = figure.subplots()
    for mode, rows in campaign.flown.items():
        for column, dash in (("solve_ms_median", "-"), ("solve_ms_p99", ":")):
            label = f"{mode}, {'median' if dash == '-' else '99th percentile'}"
            _distribution(axes, rows[column], linestyle=dash, label=label, color=mode_colour(mode))
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(
        xlabel="time per controller step [ms]", ylabel="share of trials at or below",
        ylim=(0.0, 1.02), title="Solve times of each trial",
    )  # fmt: skip
    axes.legend(loc="lower right")
    return figure


FIGURES: dict[str, Callable[[Campaign], Figure]] = {
    "residual": residual,
    "least-clearance": least_clearance,
    "violations": violations,
    "channels": channels,
    "solve-times": solve_times,
}
"""The figures of a campaign by name."""


def figures_of(campaign: Campaign) -> dict[str, Callable[[], Figure]]:
    """List how each figure of a campaign is drawn, of those that it has trials enough for."""
    if not campaign.flown:
        return {}
    left_out = ("channels",) if why_no_channels(campaign) else ()
    return {
        name: partial(draw, campaign) for name, draw in FIGURES.items() if name not in left_out
    }


def write_figures(folder: Path) -> list[Path]:
    """Draw every figure of a campaign into its folder, as PNG and PDF; none without flights."""
    figures = figures_of(Campaign.read(folder))
    return [path for name, draw in figures.items() for path in save(draw, folder / name)]
