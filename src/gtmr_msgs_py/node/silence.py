# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Reports quickly that a steady stream of messages has stopped: its node is gone, or the link.

Deadlines and liveliness of the middleware would need publishers that promise them: an estimator or
a controller that is not ours promises neither, and then would not be heard at all.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from rclpy.clock import Clock
from rclpy.clock_type import ClockType

if TYPE_CHECKING:
    from rclpy.node import Node

SILENT_S = 0.14
"""What came at 20 Hz or faster and stayed away for so long has stopped [s]."""
LOOK_S = 0.04
"""Between two looks, wall time; together they tell within 0.2 s [s]."""
INTERVALS = 3.0
"""What comes more slowly has stopped after so many of its intervals [-]."""


class Silence:
    """Watches one stream of messages by the wall's clock, once there were two of them.

    ``on_change`` is called when it stops, and when it goes on; while nothing ``is_due``, silence
    is no news.
    """

    def __init__(
        self,
        node: Node,
        what: str,
        on_change: Callable[[], object],
        is_due: Callable[[], bool] = lambda: True,
    ) -> None:
        self.silent = False
        """Whether it has stopped."""
        self._node, self._what = node, what
        self._on_change, self._is_due = on_change, is_due
        self._heard_s: float | None = None
        self._interval_s = math.inf
        self._looked_s = time.monotonic()
        node.create_timer(LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def heard(self) -> None:
        """Take in that a message came."""
        now_s = time.monotonic()
        if self._heard_s is not None:
            self._interval_s = now_s - self._heard_s
        self._heard_s = now_s
        if self.silent:
            self.silent = False
            self._node.get_logger().info(f"{self._what} again")
            self._on_change()

    def _look(self) -> None:
        now_s = time.monotonic()
        was_held_up = now_s - self._looked_s > 2.0 * LOOK_S
        self._looked_s = now_s
        if not self._is_due():
            self._heard_s = None
        if self._heard_s is None or self.silent or was_held_up:
            # A node that was held up has messages waiting that it has not read.
            return
        if now_s - self._heard_s > max(SILENT_S, INTERVALS * self._interval_s):
            self.silent = True
            self._node.get_logger().warning(f"no {self._what} for {now_s - self._heard_s:.2g} s")
            self._on_change()
