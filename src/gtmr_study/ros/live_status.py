# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the live view says in words and numbers, as HTML."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from gtmr_monitor.report import look
from gtmr_monitor.residual import ResidualWatch
from gtmr_msgs_py.messages import markers


@dataclass
class Standing(ResidualWatch):
    """How a flight has gone so far."""

    time_s: float = 0.0
    """Of the last sample [s]."""

    def add(self, time_s: float, residual_m: float) -> None:
        """Note a residual [m] at a time [s] since the start of the flight."""
        self.time_s = time_s
        self.update(residual_m)


def status(
    standings: Mapping[str, Standing],
    mode: str,
    margin_m: float,
    min_clearance_m: float,
    duration_s: float,
) -> str:
    """Say in HTML how the flights go, each ``duration_s`` long [s], of which ``mode`` flies now.

    The standings are in the order of the flights. The margin is the largest tightening of the
    plan, alpha_p + alpha_g [m]; d_min is in [m].
    """
    now = standings[mode]
    share = 100.0 * min(now.time_s / duration_s, 1.0)
    clearance_m = min_clearance_m - now.current_m
    clearance = f"{clearance_m:.2f} m" if math.isfinite(clearance_m) else "…"
    rows = "".join(
        f'<tr><th scope="row">{_swatch(look.MODE_COLOURS[name])}{name}</th>'
        f"{_row(standing, min_clearance_m)}</tr>"
        for name, standing in standings.items()
    )
    return f"""{_STYLE}<div class="gtmr">
<div class="head"><strong>{_swatch(look.MODE_COLOURS[mode])}{mode} controller</strong>
<span>{now.time_s:.1f} of {duration_s:g} s</span></div>
<div class="bar"><div style="width:{share:.1f}%;background:{look.MODE_COLOURS[mode]}"></div></div>
<div class="tiles">
<div><b class="{"bad" if now.current_m > 0.0 else ""}">{clearance}</b>
clearance</div>
<div><b>{min_clearance_m:.2f} m</b>least allowed</div>
<div><b>{margin_m:.3f} m</b>tightening</div>
</div>
<table><thead><tr><td></td><th scope="col">least clearance</th><th scope="col">too close</th></tr>
</thead><tbody>{rows}</tbody></table></div>"""


def _row(standing: Standing, min_clearance_m: float) -> str:
    if not math.isfinite(standing.current_m):
        return "<td>to be flown</td><td></td>"
    verdict = '<strong class="bad">yes</strong>' if standing.violations else "no"
    return f"<td>{min_clearance_m - standing.worst_m:.3f} m</td><td>{verdict}</td>"


def _swatch(colour: str, opacity: float = 1.0) -> str:
    return f'<i style="background:{colour};opacity:{opacity:g}"></i>'


_STYLE = """<style>
.gtmr { container-type: inline-size; padding: 2px 16px 2px 6px;
  font: 14px/1.45 system-ui, "Segoe UI", Arial, sans-serif;
  font-variant-numeric: tabular-nums; }
.gtmr i { display: inline-block; width: .75em; height: .75em; border-radius: 2px;
  margin-right: .5em; }
.gtmr .head { display: flex; flex-wrap: wrap; justify-content: space-between;
  font-size: 16px; }
.gtmr .head span { white-space: nowrap; }
.gtmr .bar { height: 4px; border-radius: 2px; background: #e3e3e3; margin: 6px 0 12px; }
.gtmr .bar div { height: 100%; border-radius: 2px; }
.gtmr .tiles { display: grid; grid-template-columns: repeat(3, 1fr); gap: 8px;
  color: #6b6b6b; font-size: 12px; }
.gtmr .tiles b { display: block; white-space: nowrap; font-weight: 600;
  font-size: clamp(15px, 7cqw, 22px); color: #1a1a1a; }
.gtmr table { width: 100%; border-collapse: collapse; margin: 12px 0 4px; }
.gtmr th, .gtmr td { text-align: left; font-weight: 400; padding: 3px 0; }
.gtmr thead th { color: #6b6b6b; font-size: 12px; }
.gtmr tbody tr { border-top: 1px solid #e3e3e3; }
.gtmr .bad, .gtmr .tiles b.bad { color: #a33c00; }
.gtmr ul { display: grid; grid-template-columns: repeat(auto-fit, minmax(11.5em, 1fr));
  gap: 2px 12px; list-style: none;
  margin: 0; padding: 0; font-size: 13px; }
</style>"""


def _css(color: markers.Color) -> str:
    return f"rgb({255 * color.r:.0f},{255 * color.g:.0f},{255 * color.b:.0f})"


_KEYS = (
    ("tower", _css(markers.CONCRETE), 1.0),
    ("reference", look.QUIET, 1.0),
    ("keep-out shell", _css(markers.FORBIDDEN), 0.5),
    ("thrust", _css(markers.THRUST), 1.0),
    ("shells, plan: robust", look.MODE_COLOURS["robust"], 1.0),
    ("clockwise rotors", _css(markers.CLOCKWISE), 1.0),
    ("shells, plan: nominal", look.MODE_COLOURS["nominal"], 1.0),
    ("counter-clockwise", _css(markers.COUNTER_CLOCKWISE), 1.0),
    ("steady wind", "#000000", 1.0),
    ("shells, plan: offset_free", look.MODE_COLOURS["offset_free"], 1.0),
)
LEGEND = (
    f'{_STYLE}<div class="gtmr"><ul>'
    + "".join(f"<li>{_swatch(colour, opacity)}{name}</li>" for name, colour, opacity in _KEYS)
    + "</ul></div>"
)
"""What is what in the scene, as HTML."""
