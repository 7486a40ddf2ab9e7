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
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from gtmr_model.dynamics import POSITION
from gtmr_msgs_py import topics
from gtmr_msgs_py.contract import BASE_LINK
from gtmr_msgs_py.messages import markers, odometry, path, rotor_states, tightening
from gtmr_msgs_py.topics import Topic
from gtmr_msgs_py.wire import attitude, stamps
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_sim import Scenario
from gtmr_study.ros.live_page import LivePage

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
    """A page that shows flights while they are flown, one mode after the other."""

    def __init__(self, duration_s: float, modes: Sequence[str]) -> None:
        scenario = Scenario()
        self.vehicle, self.tower = scenario.vehicle, scenario.tower
        self.page = LivePage(duration_s, modes, self.tower.min_clearance_m)
        self.page.draw(markers.tower(self.tower))
        self.page.add_joints(self.tower)

    def watch(self, node: Node, mode: str) -> Callable[[], None]:
        """Show the flight that a node can hear; call what is returned as often as you like."""
        return _Flight(self, node, mode).refresh


class _Flight:
    """One flight, as it is heard."""

    def __init__(self, view: LiveView, node: Node, mode: str) -> None:
        self._view, self._mode = view, mode
        self._newest: dict[str, bytes] = {}
        self._time_s, self._margin_m = 0.0, 0.0
        self._pose = np.zeros(3), np.eye(3)
        self._track: list[np.ndarray] = []
        self._drawn_at = self._shown_at = -np.inf
        for topic in SHOWN:
            # Bytes, since of most messages nothing is drawn: reading them would cost more than
            # drawing does.
            keep = partial(self._newest.__setitem__, topic.name)
            topic.subscription(node, keep, topics.NEWEST, raw=True)
        topics.CLOCK.subscription(node, self._on_clock)
        topics.CLEARANCE_RESIDUAL.subscription(node, self._on_residual)

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
            self._view.page.show(self._mode, self._margin_m)

    def _take(self, topic: Topic) -> Any:
        message = self._newest.pop(topic.name, None)
        return None if message is None else deserialize_message(message, topic.message)

    def _on_clock(self, message: Clock) -> None:
        self._time_s = stamps.seconds(stamps.decode(message.clock))

    def _on_residual(self, message: Float64) -> None:
        self._view.page.add_residual(self._mode, self._time_s, message.data)

    def _draw(self) -> None:
        view, page = self._view, self._view.page
        odom, rotors = self._take(topics.ODOM), self._take(topics.ROTOR_STATES)
        if odom is not None and rotors is not None:
            _, body = odometry.decode(odom)
            _, xi = rotor_states.decode(rotors, view.vehicle.n_rotors)
            # In its own frame the vehicle stays as it is but for the thrust: one pose moves all.
            at_rest = np.concatenate([np.zeros_like(body), xi])
            page.draw(markers.vehicle(view.vehicle, at_rest), BASE_LINK)
            page.move(odom.pose.pose)
            self._pose = body[POSITION], attitude.rotation(odom.pose.pose.orientation)
            self._draw_track(body[POSITION])
        plan, margins = self._take(topics.PREDICTED_PATH), self._take(topics.TIGHTENING)
        if plan is not None and margins is not None:
            _, planned = path.decode(plan)
            here, turned = self._pose
            tightened = tightening.decode(margins)
            margins_m = tightened.total
            self._margin_m = float(margins_m.max())
            # Seen from the vehicle the plan hardly moves, so that even a browser that draws
            # lines later than poses shows the two together.
            page.draw(markers.plan((planned - here) @ turned, self._mode), BASE_LINK)
            page.draw(markers.tightened_shells(view.tower, margins_m, planned[:, 2], self._mode))
        reference = self._take(topics.REFERENCE)
        if reference is not None:
            _, ahead = path.decode(reference)
            page.draw([markers.line("reference", ahead, REFERENCE, 0.008)])

    def _draw_track(self, position: np.ndarray) -> None:
        if self._track and np.linalg.norm(position - self._track[-1]) < TRACK_STEP_M:
            return
        self._track.append(position)
        if len(self._track) > 1:
            color = markers.MODE_COLORS[self._mode]
            name = f"track_{self._mode}"
            self._view.page.draw([markers.line(name, self._track, color, 0.006)])
