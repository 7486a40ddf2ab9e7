# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A ROS graph of real processes, and a node in the test that looks on."""

from __future__ import annotations

import fcntl
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TextIO

import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from gtmr_msgs_py.node.listening import PATIENT
from gtmr_msgs_py.node.process import PROMPT
from gtmr_msgs_py.start.environment import ros_environment
from gtmr_msgs_py.topics import Topic
from gtmr_nmpc import Controller

SOURCES = Path(__file__).parents[2] / "src"
DEADLINE_S = 60.0
"""For what is awaited, on a machine that has much else to do."""
END_S = 20.0
"""How long a process may take to end by itself when its test is over."""
DOMAINS = range(1, 102)
"""Those whose ports are free on every Linux."""


def claim_domain() -> tuple[int, TextIO]:
    """A domain that no other test run on this machine uses while the file is open."""
    for domain_id in random.sample(DOMAINS, len(DOMAINS)):
        claim = (Path(tempfile.gettempdir()) / f"gtmr_test_domain_{domain_id}").open("w")
        try:
            fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            claim.close()
        else:
            return domain_id, claim
    raise RuntimeError("all ROS domains are in use by tests")


class NodeProcess:
    """A node of the suite as a process of its own."""

    def __init__(
        self,
        module: str,
        parameters: dict[str, str],
        remaps: dict[str, str],
        options: Iterable[str],
        domain_id: int,
    ) -> None:
        arguments = [*options, "--ros-args"]
        for name, value in parameters.items():
            arguments += ["-p", f"{name}:={value}"]
        for name, value in remaps.items():
            arguments += ["-r", f"{name}:={value}"]
        environment = ros_environment(domain_id)
        environment["PYTHONPATH"] = os.pathsep.join(
            filter(None, [str(SOURCES), environment.get("PYTHONPATH")])
        )
        self._output = tempfile.TemporaryFile("w+")  # noqa: SIM115 -- lives as long as the node
        self.process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            env=environment,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    @property
    def output(self) -> str:
        """What the process has printed so far."""
        # The process writes at the position of the same open file, which must stay at the end.
        descriptor = self._output.fileno()
        return os.pread(descriptor, os.fstat(descriptor).st_size, 0).decode()

    def wait(self) -> int:
        """Exit code of a process that ends by itself."""
        return self.process.wait(DEADLINE_S)

    def interrupt(self) -> int:
        """Exit code after a Ctrl-C."""
        self.process.send_signal(signal.SIGINT)
        return self.wait()

    def end(self) -> None:
        """Wait for a process that was told to end, and forget it."""
        try:
            self.process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._output.close()


class RosGraph:
    """Nodes in a domain of their own; use it as a context manager."""

    def __init__(self) -> None:
        self.domain_id, self._claim = claim_domain()
        self.received: dict[str, list[Any]] = defaultdict(list)
        self._processes: list[NodeProcess] = []

    def __enter__(self) -> RosGraph:
        # Compiled once for this machine; no node shall do it while a deadline runs.
        Controller()
        self._context = Context()
        rclpy.init(context=self._context, domain_id=self.domain_id)
        self.node = rclpy.create_node("onlooker", context=self._context)
        self._executor = PROMPT(context=self._context)
        self._executor.add_node(self.node)
        return self

    def __exit__(self, *_: object) -> None:
        # Killed outright, a node would leave its shared memory behind on this machine for good.
        for process in self._processes:
            process.process.send_signal(signal.SIGINT)
        self.node.destroy_node()
        self._executor.shutdown()
        rclpy.shutdown(context=self._context)
        for process in self._processes:
            process.end()
        self._claim.close()

    def start(
        self,
        module: str,
        remaps: dict[str, str] | None = None,
        options: Iterable[str] = (),
        **parameters: str,
    ) -> NodeProcess:
        """Start a node; in parameter names ``__`` stands for a dot."""
        named = {name.replace("__", "."): value for name, value in parameters.items()}
        process = NodeProcess(module, named, remaps or {}, options, self.domain_id)
        self._processes.append(process)
        return process

    def listen(self, topics: Iterable[Topic], raw: bool = False) -> None:
        """Keep every message of some topics, as bytes if raw, in ``received``, by topic name."""
        for topic in topics:
            topic.subscription(self.node, self.received[topic.name].append, PATIENT, raw)

    def newcomer_finds(self, *names: str) -> float:
        """Start another participant; how long it takes to find some nodes and a publisher [s]."""
        context = Context()
        rclpy.init(context=context, domain_id=self.domain_id)
        start = time.monotonic()
        node = rclpy.create_node("newcomer", context=context)
        try:
            self.wait_until(lambda: set(names) <= set(node.get_node_names()))
            self.wait_until(lambda: node.count_publishers("odom") > 0)
            return time.monotonic() - start
        finally:
            node.destroy_node()
            rclpy.shutdown(context=context)

    def wait_until(self, condition: Callable[[], bool], deadline_s: float = DEADLINE_S) -> None:
        """Take part in the graph until something is so."""
        end = time.monotonic() + deadline_s
        while not condition():
            if time.monotonic() > end:
                said = "\n".join(process.output for process in self._processes)
                raise TimeoutError(f"not so within {deadline_s} s; the nodes said:\n{said}")
            self._executor.spin_once(timeout_sec=0.05)

    def result(self, future: Any) -> Any:
        """Wait for the answer to a service call."""
        self.wait_until(future.done)
        return future.result()

    def call(self, service: type, name: str, request: Any) -> Any:
        """Call a service."""
        client = self.node.create_client(service, name)
        self.wait_until(client.service_is_ready)
        return self.result(client.call_async(request))

    def parameters_of(self, node_name: str) -> AsyncParameterClient:
        """Talk to the parameter services of a node, once they are there."""
        client = AsyncParameterClient(self.node, node_name)
        self.wait_until(client.services_are_ready)
        return client

    def set_parameter(
        self, node_name: str, name: str, value: Any, client: AsyncParameterClient | None = None
    ) -> Any:
        """Propose a value; the result says whether it was taken."""
        client = client or self.parameters_of(node_name)
        return self.result(client.set_parameters([Parameter(name, value=value)])).results[0]

    def set_together(self, node_name: str, **values: Any) -> Any:
        """Propose values that are taken all or none; ``__`` in names stands for a dot."""
        client = self.parameters_of(node_name)
        given = [Parameter(name.replace("__", "."), value=v) for name, v in values.items()]
        return self.result(client.set_parameters_atomically(given)).result

    def get_parameter(self, node_name: str, name: str) -> Any:
        """Ask for a value."""
        client = self.parameters_of(node_name)
        message = self.result(client.get_parameters([name])).values[0]
        return rclpy.parameter.parameter_value_to_python(message)
