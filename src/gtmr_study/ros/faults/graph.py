# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A graph of real nodes to hurt, and a node of our own that looks on and sends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from gtmr_msgs_py import topics
from gtmr_msgs_py.node.process import PROMPT
from gtmr_msgs_py.start.environment import ros_environment
from gtmr_msgs_py.topics import Topic

DEADLINE_S = 30.0
"""How long anything may take that is sure to come [s]."""
PADDING = 16
"""More than the bytes that the middleware adds to a message."""
ANSWER_S = 3.0
"""How long a node may take to answer before it is asked again [s]."""
END_S = 5.0
"""How long a node may take to end [s]."""


class GraphError(RuntimeError):
    """What was sure to come did not."""


class Graph:
    """Nodes in a domain of their own; use it as a context manager."""

    def __enter__(self) -> Graph:
        """Take part in the domain."""
        self._domain_id = 1 + os.getpid() % 100
        os.environ.update(ros_environment(self._domain_id))
        self.folder = Path(tempfile.mkdtemp(prefix="gtmr_faults_"))
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.said: dict[str, dict[str, str]] = defaultdict(dict)
        """What diagnostics said last: by source, such as ``simulator``, and key."""
        self.sent: list[bytes] = []
        """What was sent from here since this was cleared."""
        self._started = 0
        self._context = Context()
        rclpy.init(context=self._context, domain_id=self._domain_id)
        self.node = rclpy.create_node("faults", context=self._context)
        self._executor = PROMPT(context=self._context)
        self._executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}
        topics.DIAGNOSTICS.subscription(self.node, self._on_diagnostics)
        return self

    def __exit__(self, *_: object) -> None:
        """End all nodes, whatever state they are in."""
        for process in self.processes.values():
            process.send_signal(signal.SIGCONT)
            process.send_signal(signal.SIGINT)
        for process in self.processes.values():
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.node.destroy_node()
        self._executor.shutdown()
        rclpy.shutdown(context=self._context)

    def start(self, name: str, *remaps: str, **parameters: Any) -> None:
        """Start ``sim``, ``nmpc`` or ``monitor``, in place of one that has ended."""
        self._started += 1
        given = [part for k, v in parameters.items() for part in ("-p", f"{k}:={v}")]
        given += [part for remap in remaps for part in ("-r", remap)]
        with (self.folder / f"{self._started}_{name}.log").open("wb") as log:
            self.processes[name] = subprocess.Popen(
                [sys.executable, "-m", f"gtmr_{name}.node", "--ros-args", *given],
                env=ros_environment(self._domain_id),
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def kill(self, name: str) -> None:
        """End a node by SIGKILL."""
        process = self.processes.pop(name)
        process.kill()
        process.wait()

    def dead(self) -> list[str]:
        """Name the nodes that have ended by themselves."""
        return [name for name, process in self.processes.items() if process.poll() is not None]

    def hear(self, topic: Topic, callback: Callable[[Any], None], name: str = "") -> None:
        """Listen to a topic; the callback gets CDR bytes."""
        self.node.create_subscription(
            topic.message, name or topic.name, callback, topics.OFFERED, raw=True
        )

    def send(self, topic: Topic, data: bytes, name: str = "") -> None:
        """Publish CDR bytes, once somebody listens."""
        name = name or topic.name
        if name not in self._publishers:
            made = self.node.create_publisher(topic.message, name, topics.OFFERED)
            self._publishers[name] = made
            self.wait_until(lambda: made.get_subscription_count() > 0)
        self.sent.append(data)
        self._publishers[name].publish(data)

    def is_sent(self, data: bytes) -> bool:
        """Whether a message is one that was sent from here; the middleware pads it."""
        alike = (each for each in self.sent if 0 <= len(data) - len(each) < PADDING)
        return any(data.startswith(each) for each in alike)

    def set(self, node: str, **values: Any) -> None:
        """Set parameters of a node, which may have been another process a moment ago."""
        given = [Parameter(name, value=value) for name, value in values.items()]
        end = time.monotonic() + DEADLINE_S
        while time.monotonic() < end:
            client = AsyncParameterClient(self.node, node)
            self.wait_until(client.services_are_ready)
            future = client.set_parameters(given)
            try:
                self.wait_until(future.done, ANSWER_S)
            except GraphError:
                continue
            return
        raise GraphError(f"{node} takes no parameters, logs in {self.folder}")

    def wait_until(self, condition: Callable[[], bool], deadline_s: float = DEADLINE_S) -> None:
        """Take part in the graph until something is so; GraphError if it is not in time."""
        end = time.monotonic() + deadline_s
        while not condition():
            if time.monotonic() > end:
                raise GraphError(f"not so within {deadline_s:g} s, logs in {self.folder}")
            self._executor.spin_once(timeout_sec=0.02)

    def go_on(self, duration_s: float) -> None:
        """Take part in the graph for a while [s]."""
        end = time.monotonic() + duration_s
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.02)

    def drops(self, source: str) -> int:
        """Count the messages that a node says it dropped, for whatever cause."""
        figures = self.said[source].items()
        return sum(int(v) for k, v in figures if k.startswith("dropped_") and v.isdigit())

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            source = self.said[status.name.rpartition(": ")[2]]
            source |= {pair.key: pair.value for pair in status.values}
            source["message"] = status.message
