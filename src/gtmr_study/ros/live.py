# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The live view of the demo: takes what the nodes publish and shows it on a page."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from threading import RLock
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from scipy.interpolate import CubicSpline
from std_msgs.msg import Float64

from gtmr_model import CHANNELS
from gtmr_model.dynamics import ATTITUDE, POSITION
from gtmr_msgs_py import topics
from gtmr_msgs_py.contract import BASE_LINK
from gtmr_msgs_py.messages import markers, odometry, path, rotor_states, tightening
from gtmr_msgs_py.topics import Topic
from gtmr_msgs_py.wire import attitude, stamps
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_sim import Scenario
from gtmr_study.ros.live_controls import Controls
from gtmr_study.ros.live_page import LivePage
from gtmr_study.ros.live_record import FlightRecord, Moment

Array = NDArray[np.float64]

DRAW_PERIOD_S = 1.0 / 20.0
"""Between two pictures, wall time [s]."""
CURVE_PERIOD_S = 0.25
"""Between two updates of curve and numbers, wall time [s]."""
TRACK_STEP_M = 0.03
"""Between two points of the flown track [m]."""
REFERENCE = markers.Color(0.42, 0.42, 0.42)
SHOWN = (
    topics.ODOM,
    topics.ROTOR_STATES,
    topics.PREDICTED_PATH,
    topics.REFERENCE,
    topics.TIGHTENING,
)
"""Of these the newest counts."""


class LiveView:
    """A page that shows flights while they are flown, one mode after the other, and afterwards."""

    def __init__(
        self, duration_s: float, modes: Sequence[str], scenario: Scenario | None = None
    ) -> None:
        scenario = scenario if scenario is not None else Scenario()
        self.vehicle, self.tower = scenario.vehicle, scenario.tower
        self.records = {mode: FlightRecord(duration_s) for mode in modes}
        """What was flown, by the mode that the flight began in."""
        self._duration_s = duration_s
        self._lock = RLock()
        self._controls: Controls | None = None
        self._zeta: list[float] = []
        self._flight = ""
        self.page = LivePage(duration_s, modes, self.tower.min_clearance_m)
        self.page.draw(markers.tower(self.tower))
        self.page.add_joints(self.tower)
        self.page.panel.on_scrub = self.scrub
        self.page.panel.on_change = self.change

    def watch(self, node: Node, mode: str) -> Callable[[], bool]:
        """Show the flight that a node can hear; call what is returned as often as you like.

        It says whether the flight is paused.
        """
        self.page.panel.follow(mode)
        self._flight = mode
        controls = Controls(node, self._on_value, self.page.panel.tell)
        self._controls = controls
        flight = _Flight(self, node, mode)

        def refresh() -> bool:
            controls.poll()
            with self._lock:
                flight.refresh()
            return controls.paused

        return refresh

    def change(self, name: str, value: Any) -> None:
        """Ask the nodes in flight for what somebody chose on the page.

        The name is that of a parameter, or ``pause``, or ``wind`` for three forces [N].
        """
        controls = self._controls
        if controls is None:
            self.page.panel.tell("no flight to change")
        elif name == "pause":
            controls.pause(bool(value))
        elif name == "mode":
            controls.set("nmpc", name, value)
        elif name == "wind":
            zeta = [*self._zeta[:6], *(float(force) for force in value)]
            if len(zeta) == len(CHANNELS):
                controls.set("sim", "zeta", zeta)
        else:
            controls.set("sim", name, float(value))

    def scrub(self, flight: str, time_s: float) -> None:
        """Show a moment of a flight [s] instead of what is flown now."""
        moment = self.records[flight].at(time_s)
        if moment is not None:
            with self._lock:
                self.show(moment)

    def show(self, moment: Moment) -> None:
        """Draw the vehicle and its plan as they were at a moment."""
        page, here = self.page, moment.body[POSITION]
        orientation = attitude.encode(moment.body[ATTITUDE])
        # In its own frame the vehicle stays as it is but for the thrust: one pose moves all.
        at_rest = np.concatenate([np.zeros_like(moment.body), moment.xi])
        page.draw(markers.vehicle(self.vehicle, at_rest), BASE_LINK)
        page.move(Pose(position=Point(**dict(zip("xyz", map(float, here), strict=True))),
                       orientation=orientation))  # fmt: skip
        # Seen from the vehicle the plan hardly moves, so that even a browser that draws
        # lines later than poses shows the two together.
        planned = (moment.planned - here) @ attitude.rotation(orientation)
        page.draw(markers.plan(planned, moment.mode), BASE_LINK)
        heights_m = moment.planned[:, 2]
        page.draw(markers.tightened_shells(self.tower, moment.margins_m, heights_m, moment.mode))

    def stay(self) -> None:
        """Serve the page with all flights, until Ctrl-C."""
        self._controls = None
        self.page.panel.flown()
        try:
            while True:
                time.sleep(DRAW_PERIOD_S)
                self.page.panel.play(DRAW_PERIOD_S)
        except KeyboardInterrupt:
            pass
        finally:
            self.page.stop()

    def _on_value(self, name: str, value: Any) -> None:
        if name == "zeta":
            self._zeta = list(value)
            self.page.blow(self._zeta[6:])
        self.page.panel.set(name, value)
        if name == "mode" and self._flight:
            self.page.panel.flying_mode = value


class _Flight:
    """One flight, as it is heard."""

    def __init__(self, view: LiveView, node: Node, mode: str) -> None:
        self._view, self._name = view, mode
        self._view.page.panel.flying_mode = mode
        self._newest: dict[str, bytes] = {}
        self._time_s = 0.0
        self._body: Array | None = None
        self._xi = np.zeros(view.vehicle.n_rotors)
        self._planned: Array | None = None
        self._margins_m: Array = np.zeros(0)
        self._track: list[Array] = []
        self._stretch, self._stretch_mode = 0, mode
        self._drawn_at = self._shown_at = -np.inf
        for topic in SHOWN:
            # Bytes, since of most messages nothing is drawn: reading them would cost more than
            # drawing does.
            keep = partial(self._newest.__setitem__, topic.name)
            topic.subscription(node, keep, topics.NEWEST, raw=True)
        topics.CLOCK.subscription(node, self._on_clock)
        topics.CLEARANCE_RESIDUAL.subscription(node, self._on_residual)

    @property
    def _mode(self) -> str:
        """That of the controller now, which somebody may have switched."""
        return self._view.page.panel.flying_mode

    def refresh(self) -> None:
        """Draw what is new, if it is time."""
        now = time.monotonic()
        if now - self._drawn_at >= DRAW_PERIOD_S:
            self._drawn_at = now
            try:
                self._draw()
            except MessageError:
                # A picture may be skipped; the nodes themselves say what is wrong.
                return
        if now - self._shown_at >= CURVE_PERIOD_S:
            self._shown_at = now
            margin_m = float(self._margins_m.max()) if self._margins_m.size else 0.0
            self._view.page.show(self._name, margin_m)

    def _take(self, topic: Topic) -> Any:
        message = self._newest.pop(topic.name, None)
        return None if message is None else deserialize_message(message, topic.message)

    def _on_clock(self, message: Clock) -> None:
        self._time_s = stamps.seconds(stamps.decode(message.clock))

    def _on_residual(self, message: Float64) -> None:
        self._view.page.add_residual(self._name, self._time_s, message.data)

    def _draw(self) -> None:
        view, page = self._view, self._view.page
        odom, rotors = self._take(topics.ODOM), self._take(topics.ROTOR_STATES)
        if odom is not None and rotors is not None:
            _, self._body = odometry.decode(odom)
            _, self._xi = rotor_states.decode(rotors, view.vehicle.n_rotors)
            self._draw_track(self._body[POSITION])
        plan, margins = self._take(topics.PREDICTED_PATH), self._take(topics.TIGHTENING)
        if plan is not None and margins is not None:
            _, self._planned = path.decode(plan)
            self._margins_m = tightening.decode(margins).total
        if self._body is not None and self._planned is not None:
            moment = Moment(
                self._time_s, self._mode, self._body, self._xi, self._planned, self._margins_m
            )
            view.records[self._name].add(moment)
            if page.panel.following:
                view.show(moment)
                page.panel.at(self._time_s)
        reference = self._take(topics.REFERENCE)
        if reference is not None:
            _, ahead = path.decode(reference)
            page.draw([markers.line("reference", _smooth(ahead), REFERENCE, 0.008)])

    def _draw_track(self, position: Array) -> None:
        if self._track and np.linalg.norm(position - self._track[-1]) < TRACK_STEP_M:
            return
        if self._mode != self._stretch_mode:
            # The line goes on in the colour of the mode that flies from here.
            self._track, self._stretch_mode = self._track[-1:], self._mode
            self._stretch += 1
        self._track.append(position)
        if len(self._track) > 1:
            color = markers.MODE_COLORS[self._mode]
            name = f"track_{self._name}_{self._stretch}"
            self._view.page.draw([markers.line(name, self._track, color, 0.006)])


def _smooth(points: Array) -> Array:
    """Draw a curve through points that are far apart, shape (n, 3), with eight times as many."""
    if len(points) < 3:
        return points
    at = np.arange(len(points))
    return np.asarray(CubicSpline(at, points)(np.linspace(0.0, at[-1], 8 * at[-1] + 1)))
