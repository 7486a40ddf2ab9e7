# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""Where the flights went, in the browser: in space and from above."""

from typing import Any

import numpy as np
import plotly.graph_objects as go

from gtmr_monitor.flight import Flight
from gtmr_monitor.report import look
from gtmr_monitor.report.charts import LIMIT, Chart, plot, short
from gtmr_monitor.report.decimation import kept
from gtmr_monitor.report.look import Flown, themed

_DOTS = {"color": themed("quiet"), "width": 2, "dash": "dot"}
_ELEVATION_DEG = 24.0


def trajectory(flown: Flown) -> list[Chart]:
    """Draw the flights around the tower: in space, and from above."""
    flown = look.stacked(look.by_mode(look.moved(flown)))
    return [
        Chart(_in_space(flown), "Flights around the tower, in space", "In space", share=1.1),
        Chart(_from_above(flown), "Flights around the tower, from above", "From above"),
    ]


def _in_space(flown: Flown) -> go.Figure:
    first = flown[0][0]
    height, reference = look.heights(flown), look.reference(flown)
    figure = plot(480)
    # A little light shines through the tower: what is behind it is seen to be there, but faint.
    for radius, key, opacity, name in (
        (first.tower.radius_m, "tower", 0.88, "tower"),
        (first.tower.radius_m + first.tower.min_clearance_m, "limit", 0.1, "d<sub>min</sub>"),
    ):
        x, y, z = look.cylinder(radius, height)
        figure.add_surface(
            x=short(x), y=short(y), z=short(z), opacity=opacity, name=name, hoverinfo="skip",
            colorscale=[[0.0, themed(key)], [1.0, themed(key)]], showscale=False, showlegend=True,
            lighting={"ambient": 0.9, "diffuse": 0.35, "specular": 0.02},
        )  # fmt: skip
    figure.add_scatter3d(
        **_xyz(reference), mode="lines", line=_DOTS, name="reference", hoverinfo="skip"
    )
    for flight, line in flown:
        shown = kept(flight.clearance)
        figure.add_scatter3d(
            **_xyz(flight.p[shown]), mode="lines", name=line.label,
            line={"color": line.themed, "dash": line.dash, "width": 2.0 + 2.0 * line.width_px},
            customdata=_said(flight, shown), hovertemplate=_SAYS,
        )  # fmt: skip
    wide, tall = 2.0 * np.abs(reference[:, :2]).max(), height[1] - height[0]
    to_scale = tall <= 1.5 * wide
    axis = {
        "backgroundcolor": themed("page"), "gridcolor": themed("grid"), "showspikes": False,
        "linecolor": themed("quiet"), "zeroline": False, "nticks": 6,
    }  # fmt: skip
    azimuth, elevation = look.viewpoint(flown) - np.radians(15.0), np.radians(_ELEVATION_DEG)
    eye = 2.0 * np.array([np.cos(elevation) * np.cos(azimuth),
                           np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])  # fmt: skip
    figure.update_scenes(
        xaxis={**axis, "title": {"text": "x, east [m]"}},
        yaxis={**axis, "title": {"text": "y, north [m]"}},
        zaxis={**axis, "title": {"text": "z [m]" if to_scale else "z [m], not to scale"}},
        # A long climb would shrink a true-to-scale box to a needle.
        aspectmode="data" if to_scale else "cube",
        camera={"eye": dict(zip("xyz", eye, strict=True)), "center": {"x": 0, "y": 0, "z": -0.1}},
    )
    figure.update_layout(margin={"l": 0, "r": 0, "b": 0})
    return figure


def _from_above(flown: Flown) -> go.Figure:
    tower, reference = flown[0][0].tower, look.reference(flown)
    figure = plot(480, "x, east [m]", "y, north [m]", hovermode="closest")
    x, y = look.circle(tower.radius_m)
    figure.add_scatter(
        x=short(x), y=short(y), mode="lines", fill="toself", fillcolor=themed("tower"),
        line={"color": themed("tower"), "width": 1}, name="tower", hoverinfo="skip",
    )  # fmt: skip
    x, y = look.circle(tower.radius_m + tower.min_clearance_m)
    name = f"d<sub>min</sub> = {tower.min_clearance_m:g} m"
    figure.add_scatter(
        x=short(x), y=short(y), mode="lines", line=LIMIT, name=name, hoverinfo="skip"
    )
    x, y = short(reference[:, :2].T)
    figure.add_scatter(x=x, y=y, mode="lines", line=_DOTS, name="reference", hoverinfo="skip")
    for flight, line in flown:
        shown = kept(flight.clearance)
        x, y = short(flight.p[shown, :2].T)
        figure.add_scatter(
            x=x, y=y, mode="lines", name=line.label,
            line={"color": line.themed, "dash": line.dash, "width": line.width_px},
            customdata=_said(flight, shown), hovertemplate=_SAYS,
        )  # fmt: skip
    paths = np.concatenate([reference, *(flight.p for flight, _ in flown)])
    reach = 1.06 * max(np.abs(paths[:, :2]).max(), tower.radius_m + tower.min_clearance_m)
    figure.update_yaxes(scaleanchor="x", constrain="domain", range=(-reach, reach))
    figure.update_xaxes(constrain="domain", range=(-reach, reach))
    return figure


_SAYS = (
    "%{customdata[0]:.2f} s<br>clearance %{customdata[1]:.3f} m<br>z = %{customdata[2]:.2f} m"
    "<extra>%{fullData.name}</extra>"
)


def _said(flight: Flight, shown: Any) -> Any:
    columns = (flight.t[shown], flight.clearance[shown], flight.p[shown, 2])
    return short(np.column_stack(columns))


def _xyz(points: Any) -> dict[str, Any]:
    return dict(zip("xyz", short(points.T), strict=True))
