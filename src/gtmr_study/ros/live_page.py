# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The page of the live view: visualization markers in space, the residual, and how it goes.

It is served by viser, which is needed for this alone: ``pip install 'gtmr[live]'``.
"""

import atexit
import io
import itertools
import math
from collections.abc import Iterable, Sequence
from contextlib import redirect_stdout
from typing import Any

import numpy as np
import viser
from geometry_msgs.msg import Pose
from numpy.typing import NDArray
from visualization_msgs.msg import Marker

from gtmr_model import Tower
from gtmr_monitor.report import look
from gtmr_msgs_py.contract import BASE_LINK, MAP
from gtmr_msgs_py.messages import markers
from gtmr_study.ros.live_panel import Panel
from gtmr_study.ros.live_status import LEGEND, Standing, status

LOOPBACK = "127.0.0.1"
"""The only address the page is served at: who else is on the network cannot see it."""
PORT = 8090
"""Where the page is served; the next free port if it is taken."""
CURVE_POINTS = 400
"""How many points a residual curve has at most; each is the largest of its share of time."""
PANEL_WIDTH_PX = 430
CURVE_HEIGHT_PX = 230
RESIDUAL_RANGE_M = (-0.3, 0.05)
"""What the curve shows at least [m]."""
CAMERA_M = (3.6, -2.9, 1.6)
LOOK_AT_M = (0.95, 0.0, 0.0)
"""Camera and its target, seen from the tower's axis at the vehicle's height, x outwards [m]."""
JOINTS_EVERY_M = 1.0
SEAMS = 8
"""Joints around the tower and seams along it, so that one sees the vehicle move."""
WEATHER_ABOVE_M = 0.75
"""How far above the vehicle the axes of the world and the wind are [m]."""
WORLD_AXES_M, BODY_AXES_M = 0.25, 0.3
WIND_M_PER_N = 0.8
"""Length of the wind's arrow [m/N]."""
WIND_COLOR = (0, 0, 0)
SHELLS = ("d_min", "tightened")
"""Namespaces of what is around the whole tower."""
NARROW_PX = 600
"""Width of a window that leaves no room for the panel beside the scene."""
FARTHER, LOWER_M = 1.5, np.array([0.0, 0.0, -0.9])
"""How far the camera stands back then, and how much lower it looks [m]."""
JOINT_COLOR = (150, 150, 146)


class LivePage:
    """A page in the browser that shows what it is given, to whoever opens it and whenever.

    It shows flights of ``duration_s`` [s], one a mode, with d_min ``min_clearance_m`` [m].
    """

    def __init__(self, duration_s: float, modes: Sequence[str], min_clearance_m: float) -> None:
        self._duration_s = duration_s
        self._min_clearance_m = min_clearance_m
        # The largest residual in each share of time, NaN where there is none yet [m].
        self._curves = {mode: np.full(CURVE_POINTS, np.nan) for mode in modes}
        self._standings = {mode: Standing() for mode in modes}
        self._range = RESIDUAL_RANGE_M
        # What viser has for a marker, and its properties as the page has them.
        self._drawn: dict[str, tuple[Any, dict[str, Any]]] = {}
        # viser prints where it listens, and that it stops, whatever it is told.
        with redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(LOOPBACK, PORT, "gtmr live", verbose=False)
        atexit.register(self.stop)
        self._furnish()
        self._lay_out()
        self._server.on_client_connect(self._fit)

    @property
    def url(self) -> str:
        """Where to find the page."""
        return f"http://{LOOPBACK}:{self._server.get_port()}"

    def stop(self) -> None:
        """Serve the page no longer."""
        atexit.unregister(self.stop)
        with redirect_stdout(io.StringIO()):
            self._server.stop()

    def draw(self, drawn: Iterable[Marker], frame: str = MAP) -> None:
        """Show markers in space, in place of those of the same namespace and number.

        They are in `map`, or in `base_link` for what goes along with the vehicle [m].
        """
        with self._server.atomic():
            for marker in drawn:
                self._draw(marker, self._frames[frame].name)

    def add_joints(self, tower: Tower) -> None:
        """Give the tower's smooth surface something to see motion by."""
        # Just off the surface, which would swallow half of each line.
        radius, top = tower.radius_m + 0.002, markers.DRAWN_HEIGHT_M
        angle = np.linspace(0.0, 2.0 * np.pi, 97)
        circle = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        segments = [
            [(*here, z), (*there, z)]
            for z in np.arange(JOINTS_EVERY_M, top, JOINTS_EVERY_M)
            for here, there in itertools.pairwise(circle)
        ]
        seams = circle[: -1 : (len(circle) - 1) // SEAMS]
        segments += [[(*at, 0.0), (*at, top)] for at in seams]
        self._server.scene.add_line_segments(
            f"/{MAP}/joints", np.array(segments), JOINT_COLOR, thickness=0.006
        )

    def move(self, pose: Pose) -> None:
        """Put the vehicle where it is in `map` [m], and turn the scene so that it stays in sight.

        Not the camera follows the vehicle but the world turns, so that a viewer is free to look
        from elsewhere meanwhile.
        """
        at, turned = pose.position, pose.orientation
        azimuth = math.atan2(at.y, at.x) if self._follow.value else 0.0
        with self._server.atomic():
            world, vehicle = self._frames[MAP], self._frames[BASE_LINK]
            world.wxyz = (math.cos(0.5 * azimuth), 0.0, 0.0, -math.sin(0.5 * azimuth))
            world.position = (0.0, 0.0, -at.z)
            vehicle.wxyz = (turned.w, turned.x, turned.y, turned.z)
            vehicle.position = (at.x, at.y, at.z)
            # Outside of the propellers, where nothing covers them.
            self._weather.position = (at.x, at.y, at.z + WEATHER_ABOVE_M)

    def blow(self, force_n: Sequence[float]) -> None:
        """Show the steady wind as an arrow above the vehicle: a force in `map` [N]."""
        tip = WIND_M_PER_N * np.asarray(force_n, dtype=float)
        if np.linalg.norm(tip) < 0.01:
            tip = np.array([0.0, 0.0, 0.01])
        self._wind.points = np.array([[np.zeros(3), tip]], dtype=np.float32)

    def add_residual(self, mode: str, time_s: float, residual_m: float) -> None:
        """Note a residual s [m] at a time [s] since the start; ``show`` shows it."""
        curve = self._curves[mode]
        i = min(int(CURVE_POINTS * time_s / self._duration_s), CURVE_POINTS - 1)
        curve[i] = np.fmax(curve[i], residual_m)
        self._standings[mode].add(time_s, residual_m)

    def show(self, mode: str, margin_m: float) -> None:
        """Bring curve and numbers up to date; the margin is the largest of the plan [m]."""
        self._status.content = status(
            self._standings, mode, margin_m, self._min_clearance_m, self._duration_s
        )
        seen = np.concatenate([curve[np.isfinite(curve)] for curve in self._curves.values()])
        if seen.size:
            low, high = self._range
            wanted = min(low, seen.min() - 0.02), max(high, seen.max() + 0.02)
            if wanted != self._range:
                self._range = wanted
                self._curve.scales = self._scales()
        self._curve.data = self._data()

    def _furnish(self) -> None:
        """Set up what is the same in every flight: light, camera, the root of the scene."""
        scene, camera = self._server.scene, self._server.initial_camera
        scene.set_up_direction("+z")
        # Plain lights: an environment map costs a slow machine most of its time, and hides the
        # scene while it loads.
        scene.configure_environment_map(None)
        scene.add_light_hemisphere("/sky", ground_color=(190, 190, 185), intensity=2.5)
        scene.configure_default_lights(cast_shadow=False)
        camera.position, camera.look_at = CAMERA_M, LOOK_AT_M
        camera.fov = math.radians(45.0)
        self._frames = {
            MAP: scene.add_frame(f"/{MAP}", show_axes=False),
            BASE_LINK: scene.add_frame(
                f"/{MAP}/{BASE_LINK}", axes_length=BODY_AXES_M, axes_radius=0.008
            ),
        }
        self._weather = scene.add_frame(
            f"/{MAP}/weather", axes_length=WORLD_AXES_M, axes_radius=0.008
        )
        for axis, at in zip("xyz", np.eye(3), strict=True):
            scene.add_label(f"/{MAP}/weather/{axis}", axis, position=1.2 * WORLD_AXES_M * at)
        self._wind = scene.add_arrows(
            f"/{MAP}/weather/wind",
            points=np.zeros((1, 2, 3), dtype=np.float32),
            colors=np.array(WIND_COLOR, dtype=np.uint8),
            shaft_radius=0.015,
            head_radius=0.04,
            head_length=0.08,
        )

    def _fit(self, client: viser.ClientHandle) -> None:
        """Frame the vehicle in what the panel leaves free, if the window is as narrow as a phone.

        There the page has its panel in front of the lower part of the scene.
        """
        if client.camera.image_width < NARROW_PX:
            client.camera.position = tuple(FARTHER * np.array(CAMERA_M) + LOWER_M)
            client.camera.look_at = tuple(np.array(LOOK_AT_M) + LOWER_M)

    def _lay_out(self) -> None:
        """Set up the panel at the side."""
        gui = self._server.gui
        # Sharing would open a tunnel to a server outside.
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.set_panel_label("gtmr live")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH_PX)
        self._status = gui.add_html("")
        lines = {"stroke": look.GRID, "width": 1}
        axis: Any = {"stroke": look.QUIET, "grid": lines, "ticks": lines, "labelSize": 20}
        time_axis: Any = {**axis, "label": "time [s]", "size": 36}
        residual_axis: Any = {**axis, "label": "s = d_min − d_T [m]", "size": 50}
        series: list[Any] = [
            {"label": "time [s]"},
            *({"label": m, "stroke": look.MODE_COLOURS[m], "width": 2} for m in self._curves),
            {"label": "safety line", "stroke": look.LIMIT, "width": 1.5, "dash": (6, 4)},
        ]
        self._curve = gui.add_uplot(
            self._data(),
            tuple(series),
            scales=self._scales(),
            axes=(time_axis, residual_axis),
            legend={"live": False},
            height=CURVE_HEIGHT_PX,
        )
        gui.add_html(LEGEND)
        self.panel = Panel(gui, self._duration_s, list(self._curves))
        self._follow = gui.add_checkbox(
            "Follow", True, hint="Turn the world so that the vehicle stays in sight"
        )

    def _data(self) -> tuple[NDArray[np.float64], ...]:
        time_s = (np.arange(CURVE_POINTS) + 0.5) * self._duration_s / CURVE_POINTS
        curves = [curve.copy() for curve in self._curves.values()]
        return (time_s, *curves, np.zeros(CURVE_POINTS))

    def _scales(self) -> dict[str, Any]:
        return {
            "x": {"time": False, "range": (0.0, self._duration_s)},
            "y": {"range": self._range},
        }

    def _draw(self, marker: Marker, parent: str) -> None:
        name = f"{parent}/{marker.ns}/{marker.id}"
        properties = _properties(marker)
        if name not in self._drawn:
            self._drawn[name] = self._add(name, marker, properties), properties
            return
        handle, shown = self._drawn[name]
        for prop, value in properties.items():
            if not np.array_equal(value, shown[prop]):
                setattr(handle, prop, value)
        self._drawn[name] = handle, properties

    def _add(self, name: str, marker: Marker, properties: dict[str, Any]) -> Any:
        scene = self._server.scene
        if marker.type == Marker.CYLINDER:
            # Of a shell around the tower the far side is enough, and does not tint the tower.
            side: Any = "back" if marker.ns in SHELLS else "front"
            return scene.add_cylinder(name, 0.5, 1.0, radial_segments=96, side=side, **properties)
        if marker.type == Marker.CUBE:
            return scene.add_box(name, dimensions=(1.0, 1.0, 1.0), **properties)
        if marker.type == Marker.ARROW:
            return scene.add_arrows(name, **properties)
        return scene.add_line_segments(name, **properties)


def _properties(marker: Marker) -> dict[str, Any]:
    """Properties of a marker, by the names that viser has for them."""
    color = tuple(round(255 * part) for part in (marker.color.r, marker.color.g, marker.color.b))
    points = np.array([(p.x, p.y, p.z) for p in marker.points], dtype=np.float32)
    if marker.type == Marker.ARROW:
        return {
            "points": points[None],
            "colors": np.array(color, dtype=np.uint8),
            "shaft_radius": 0.5 * marker.scale.x,
            "head_radius": 0.5 * marker.scale.y,
            "head_length": marker.scale.z,
        }
    if marker.type in (Marker.LINE_STRIP, Marker.LINE_LIST):
        if marker.type == Marker.LINE_STRIP:
            points = np.stack([points[:-1], points[1:]], axis=1).reshape(-1, 3)
        return {
            "points": points.reshape(-1, 2, 3),
            "colors": np.array(color, dtype=np.uint8),
            "thickness": marker.scale.x,
        }
    at, turned, size = marker.pose.position, marker.pose.orientation, marker.scale
    return {
        "color": color,
        "opacity": None if marker.color.a >= 1.0 else marker.color.a,
        "scale": (size.x, size.y, size.z),
        "position": (at.x, at.y, at.z),
        "wxyz": (turned.w, turned.x, turned.y, turned.z),
    }
