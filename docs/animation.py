# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Draws docs/flight.webp: three flights around the tower, from above, and their clearance.

Run `.venv/bin/python docs/animation.py`; it flies what it shows. The wind is that of Fig. 1, with
gusts at random, the same for all three.
"""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Circle
from PIL import Image

from gtmr_monitor.report.look import INK, MODE_COLOURS, QUIET, TOWER
from gtmr_nmpc import MODES, Controller
from gtmr_sim import FlightLog, Scenario, fly

PICTURE = Path(__file__).with_name("flight.webp")
STILL = PICTURE.parent / "sphinx" / "static" / "flight-still.webp"
"""What the site shows to those who wish that nothing moves."""
FLOWN_S, SHOWN_S = 16.0, 8.0
"""Of flight, and of the loop: it plays twice as fast as it was flown."""
FRAMES_PER_S = 12
SIZE_PX = (640, 800)
TAIL_S = 5.0
"""How much of a flight's past stays in the picture."""
STYLES = {"nominal": "-", "robust": "--", "offset_free": "-"}


def flights() -> dict[str, FlightLog]:
    """Fly every mode through the same wind."""
    scenario = Scenario(seed=1, zeta=(0, 0, 0, 0, 0, 0, 0.6, 0.4, 0))
    return {mode: fly(scenario, Controller(mode=mode), FLOWN_S) for mode in MODES}


def draw(logs: dict[str, FlightLog], time_s: float) -> Image.Image:
    """Draw one frame."""
    scenario = Scenario()
    tower, vehicle = scenario.tower, scenario.vehicle
    figure = plt.figure(figsize=(SIZE_PX[0] / 100, SIZE_PX[1] / 100), dpi=100)
    above, below = figure.subplots(2, 1, height_ratios=(2.7, 1))
    now = round(time_s / 0.025)
    radius = vehicle.rotor_radius_m or 0.1

    shell = tower.radius_m + tower.min_clearance_m
    above.add_patch(Circle((0, 0), shell, facecolor="#f6dfd3", edgecolor=INK, linestyle=":"))
    above.add_patch(Circle((0, 0), tower.radius_m, facecolor=TOWER, edgecolor=QUIET))
    above.text(0, 0, "tower", ha="center", va="center", fontsize=15)
    above.annotate(
        "d_min = 0.2 m", (0.64 * shell, -0.77 * shell),
        (2.1, -2.02), ha="right", fontsize=15, arrowprops={"arrowstyle": "-", "color": INK},
    )  # fmt: skip
    for mode, log in logs.items():
        colour = MODE_COLOURS[mode]
        past = slice(max(0, now - round(TAIL_S / 0.025)), now + 1)
        above.plot(*log.x[past, :2].T, STYLES[mode], color=colour, linewidth=2.4)
        x, y, yaw = log.x[now, [0, 1, 5]]
        for rotor in vehicle.rotors:
            px, py = rotation(yaw) @ np.asarray(rotor.position_m)[:2]
            above.plot([x, x + px], [y, y + py], color=colour, linewidth=1.6, alpha=0.8)
            above.add_patch(
                Circle((x + px, y + py), radius, fill=False, edgecolor=colour, alpha=0.8)
            )
        above.plot(x, y, "o", color=colour, markersize=9, markeredgecolor="white")
    above.annotate(
        "wind", (-1.25, -1.62), (-1.95, -2.0), fontsize=15, va="center",
        arrowprops={"arrowstyle": "-|>", "color": INK, "linewidth": 2},
    )  # fmt: skip
    above.set(xlim=(-2.15, 2.15), ylim=(-2.15, 2.15), aspect="equal", xticks=[], yticks=[])
    above.set_title("Three controllers in one wind, from above", fontsize=16)

    for mode, log in logs.items():
        label = f"{mode} {log.d_T.min():.3f} m"
        colour = MODE_COLOURS[mode]
        below.plot(log.t[: now + 1], log.d_T[: now + 1], STYLES[mode], color=colour,
                   linewidth=2.2, label=label)  # fmt: skip
    below.axhspan(0.0, tower.min_clearance_m, color="#f6dfd3")
    below.axhline(tower.min_clearance_m, color=INK, linestyle=":")
    below.text(FLOWN_S - 0.2, 0.19, "closer than d_min", fontsize=14, va="top", ha="right")
    below.set(xlim=(0, FLOWN_S), ylim=(0.1, 0.75), yticks=[0.2, 0.35, 0.7])
    below.tick_params(labelsize=13)
    below.set_xlabel("time [s]", fontsize=14)
    below.set_ylabel("clearance [m]", fontsize=14)
    figure.legend(
        *below.get_legend_handles_labels(), loc="lower center", ncols=3, fontsize=13,
        frameon=False, handlelength=1.3, columnspacing=0.9, title="least clearance",
        title_fontsize=13,
    )  # fmt: skip
    figure.tight_layout(rect=(0, 0.075, 1, 1))
    kept = io.BytesIO()
    figure.savefig(kept, format="png")
    plt.close(figure)
    return Image.open(kept).convert("RGB")


def rotation(yaw: float) -> np.ndarray:
    """Turn by a yaw angle [rad], shape (2, 2)."""
    return np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])


def main() -> None:
    """Fly, draw and write."""
    mpl.use("agg")
    logs = flights()
    last = (len(logs["robust"].t) - 1) * 0.025
    frames = [draw(logs, t) for t in np.linspace(0.0, last, round(SHOWN_S * FRAMES_PER_S))]
    frames[0].save(
        PICTURE, save_all=True, append_images=frames[1:], duration=round(1000 / FRAMES_PER_S),
        loop=0, quality=70, method=4,
    )  # fmt: skip
    frames[-1].save(STILL, quality=80)


if __name__ == "__main__":
    main()
