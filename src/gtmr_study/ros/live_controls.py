# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the live page may change in flight: parameters of the nodes, and whether time goes by."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from threading import Lock
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from std_srvs.srv import SetBool

from gtmr_msgs_py import topics

SHOWN = {"sim": ("zeta", "gust.std_n", "real_time_factor"), "nmpc": ("mode",)}
"""Parameters that the page shows, by node."""
ANSWER_S = 2.0
"""How long a node may take to answer before it is asked again: while nodes find each other an
answer may be lost [s]."""
OnValue = Callable[[str, Any], None]
"""Told the name of a parameter and the value that its node has."""
OnAnswer = Callable[[str], None]
"""Told why a value was refused; nothing if it was taken."""


class Controls:
    """Sets parameters of the nodes through their services; any thread may ask.

    Of values that are asked for faster than nodes answer the newest counts.
    """

    def __init__(self, node: Node, on_value: OnValue, on_answer: OnAnswer) -> None:
        self._clients = {name: AsyncParameterClient(node, name) for name in SHOWN}
        self._pause_service = node.create_client(
            topics.PAUSE.service, topics.PAUSE.name.replace("~", topics.PAUSE.server)
        )
        self._on_value, self._on_answer = on_value, on_answer
        self._lock = Lock()
        self._wanted: dict[tuple[str, str], Any] = {}
        self._asked: dict[tuple[str, str], tuple[float, Any]] = {}
        self._unread = dict.fromkeys(SHOWN, 0.0)
        self.paused = False
        """Whether the simulator was asked to stop its time."""

    def set(self, node: str, name: str, value: Any) -> None:
        """Ask a node, ``sim`` or ``nmpc``, to take a value."""
        with self._lock:
            self._wanted[node, name] = value

    def pause(self, paused: bool) -> None:
        """Stop simulated time, or let it go on."""
        self.paused = paused
        with self._lock:
            self._wanted["sim", ""] = paused

    def poll(self) -> None:
        """Pass on what was asked for; to be called by the thread that spins the node."""
        now = time.monotonic()
        for node, due_at in list(self._unread.items()):
            if now >= due_at and self._clients[node].services_are_ready():
                self._unread[node] = now + ANSWER_S
                names = list(SHOWN[node])
                future = self._clients[node].get_parameters(names)
                future.add_done_callback(partial(self._was_read, node, names))
        with self._lock:
            for key in [key for key, (until, _) in self._asked.items() if now >= until]:
                self._wanted.setdefault(key, self._asked.pop(key)[1])
            due = {key: v for key, v in self._wanted.items() if key not in self._asked}
            due = {key: v for key, v in due.items() if self._is_there(*key)}
            for key in due:
                del self._wanted[key]
        for key, value in due.items():
            self._asked[key] = now + ANSWER_S, value
            self._ask(*key, value)

    def _is_there(self, node: str, name: str) -> bool:
        if not name:
            return bool(self._pause_service.service_is_ready())
        return bool(self._clients[node].services_are_ready())

    def _ask(self, node: str, name: str, value: Any) -> None:
        if not name:
            future = self._pause_service.call_async(SetBool.Request(data=value))
            future.add_done_callback(lambda _: self._asked.pop((node, name), None))
            return
        future = self._clients[node].set_parameters([Parameter(name, value=value)])
        future.add_done_callback(partial(self._answered, node, name, value))

    def _answered(self, node: str, name: str, value: Any, future: Any) -> None:
        self._asked.pop((node, name), None)
        result: SetParametersResult = future.result().results[0]
        self._on_answer("" if result.successful else f"{node} refused {name}: {result.reason}")
        if result.successful:
            self._on_value(name, value)
        else:
            # The page shows what the node has, and not what it was asked for.
            self._unread[node] = 0.0

    def _was_read(self, node: str, names: list[str], future: Any) -> None:
        self._unread.pop(node, None)
        for name, value in zip(names, future.result().values, strict=True):
            self._on_value(name, parameter_value_to_python(value))
