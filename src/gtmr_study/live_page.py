"""The page of the live view: visualization markers in space, the residual, and how it goes.

It is served by viser, which is needed for this alone: ``pip install 'gtmr[live]'``.
"""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Iterable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from visualization_msgs.msg import Marker

from gtmr_model import Tower
from gtmr_monitor import look
from gtmr_msgs_py import markers
from gtmr_study.live_status import LEGEND, Standing, status

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
CAMERA_M = (3.2, -2.5, 1.5)
LOOK_AT_M = (0.95, 0.0, 0.0)
"""Camera and its target, seen from the tower's axis at the vehicle's height, x outwards [m]."""
JOINTS_EVERY_M = 1.0
SEAMS = 8
"""Joints round the tower and seams along it, so that one sees the vehicle move."""
JOINT_COLOR = (150, 150, 146)
ROOT = "/map"


@dataclass
class _Curve:
    """The residual of a flight over time, at an even step."""

    residual: NDArray[np.float64]
    """The largest in each share of time, NaN where there is none yet [m]."""
    standing: Standing = field(default_factory=Standing)


class LivePage:
    """A page in the browser that shows what it is given, to whoever opens it and whenever.

    Parameters
    ----------
    duration_s : float
        Length of a flight [s].
    modes : sequence of str
        What is flown, in turn.
    min_clearance_m : float
        d_min [m].
    """

    def __init__(self, duration_s: float, modes: Sequence[str], min_clearance_m: float) -> None:
        self._duration_s = duration_s
        self._min_clearance_m = min_clearance_m
        self._curves = {mode: _Curve(np.full(CURVE_POINTS, np.nan)) for mode in modes}
        self._range = RESIDUAL_RANGE_M
        self._drawn: dict[str, Any] = {}
        # viser prints where it listens, and that it stops, whatever it is told.
        with redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(LOOPBACK, PORT, "gtmr live", verbose=False)
        self._furnish()
        self._lay_out()

    @property
    def url(self) -> str:
        """Where to find the page."""
        return f"http://{LOOPBACK}:{self._server.get_port()}"

    def stop(self) -> None:
        """Serve the page no longer."""
        with redirect_stdout(io.StringIO()):
            self._server.stop()

    def draw(self, drawn: Iterable[Marker]) -> None:
        """Show markers in space, in place of those of the same namespace and number.

        Parameters
        ----------
        drawn : iterable of visualization_msgs.msg.Marker
            Cylinders, boxes, lines and arrows, in the world frame [m].
        """
        with self._server.atomic():
            for marker in drawn:
                self._draw(marker)

    def add_joints(self, tower: Tower) -> None:
        """Give the tower's smooth surface something to see motion by.

        Parameters
        ----------
        tower : Tower
            On the z axis of the world frame.
        """
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
            f"{ROOT}/joints", np.array(segments), JOINT_COLOR, thickness=0.006
        )

    def follow(self, position: NDArray[np.float64]) -> None:
        """Turn the scene so that the vehicle stays in sight, if the viewer wants that.

        Not the camera moves but the world, so that the viewer's own view stays as it is.

        Parameters
        ----------
        position : NDArray, shape (3,)
            Of the vehicle, world frame [m].
        """
        azimuth = math.atan2(position[1], position[0]) if self._follow.value else 0.0
        self._root.wxyz = (math.cos(0.5 * azimuth), 0.0, 0.0, -math.sin(0.5 * azimuth))
        self._root.position = (0.0, 0.0, -float(position[2]))

    def add_residual(self, mode: str, time_s: float, residual_m: float) -> None:
        """Note a sample of the residual; ``show`` shows it.

        Parameters
        ----------
        mode : str
            Of the flight.
        time_s : float
            Since the start of the flight [s].
        residual_m : float
            s = d_min - d_T [m].
        """
        curve = self._curves[mode]
        i = min(int(CURVE_POINTS * time_s / self._duration_s), CURVE_POINTS - 1)
        curve.residual[i] = np.fmax(curve.residual[i], residual_m)
        curve.standing.add(time_s, residual_m)

    def show(self, mode: str, margin_m: float) -> None:
        """Bring curve and numbers up to date.

        Parameters
        ----------
        mode : str
            What is flown now.
        margin_m : float
            The largest tightening of the plan, alpha_p + alpha_g [m].
        """
        self._status.content = status(
            {name: curve.standing for name, curve in self._curves.items()},
            mode,
            margin_m,
            self._min_clearance_m,
            self._duration_s,
        )
        curves = [curve.residual for curve in self._curves.values()]
        seen = np.concatenate([curve[np.isfinite(curve)] for curve in curves])
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
        scene.configure_environment_map("studio", environment_intensity=0.35)
        scene.configure_default_lights(cast_shadow=False)
        camera.position, camera.look_at = CAMERA_M, LOOK_AT_M
        camera.fov = math.radians(45.0)
        self._root = scene.add_frame(ROOT, show_axes=False)

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
        self._follow = gui.add_checkbox(
            "Follow", True, hint="Turn the world so that the vehicle stays in sight"
        )

    def _data(self) -> tuple[NDArray[np.float64], ...]:
        time_s = (np.arange(CURVE_POINTS) + 0.5) * self._duration_s / CURVE_POINTS
        curves = [curve.residual.copy() for curve in self._curves.values()]
        return (time_s, *curves, np.zeros(CURVE_POINTS))

    def _scales(self) -> dict[str, Any]:
        return {
            "x": {"time": False, "range": (0.0, self._duration_s)},
            "y": {"range": self._range},
        }

    def _draw(self, marker: Marker) -> None:
        name = f"{ROOT}/{marker.ns}/{marker.id}"
        look_of = _look(marker)
        handle = self._drawn.get(name)
        if handle is None:
            self._drawn[name] = self._add(name, marker, look_of)
        else:
            for prop, value in look_of.items():
                setattr(handle, prop, value)

    def _add(self, name: str, marker: Marker, look_of: dict[str, Any]) -> Any:
        scene = self._server.scene
        if marker.type == Marker.CYLINDER:
            return scene.add_cylinder(name, 0.5, 1.0, radial_segments=96, **look_of)
        if marker.type == Marker.CUBE:
            return scene.add_box(name, dimensions=(1.0, 1.0, 1.0), **look_of)
        if marker.type == Marker.ARROW:
            return scene.add_arrows(name, **look_of)
        return scene.add_line_segments(name, **look_of)


def _look(marker: Marker) -> dict[str, Any]:
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
