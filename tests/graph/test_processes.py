# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the demo starts is closed to the network, and ends with it whatever ends it."""

import os
import signal
import subprocess

import pytest
from support.command_line import command
from support.processes import (
    command_line,
    is_alive,
    is_open_to_the_network,
    open_addresses,
    running,
    wait_until,
)

NODES = ("gtmr_sim.node", "gtmr_nmpc.node", "gtmr_monitor.node")


@pytest.mark.parametrize("stop", [signal.SIGTERM, signal.SIGKILL])
def test_the_demo_is_closed_to_the_network_and_leaves_no_node_behind(tmp_path, stop):
    demo = subprocess.Popen(
        command("demo", "--duration", 60, "--modes", "nominal", "--out", tmp_path / "out"),
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    nodes = []
    try:
        wait_until(lambda: len(running(demo.pid, NODES)) == len(NODES))
        nodes = running(demo.pid, NODES)
        wait_until(lambda: all(map(open_addresses, [demo.pid, *nodes])))
        for process_id in (demo.pid, *nodes):
            reached = {address for _, address in open_addresses(process_id)}
            assert not set(filter(is_open_to_the_network, reached)), command_line(process_id)
        demo.send_signal(stop)
        _, said = demo.communicate(timeout=60)
        wait_until(lambda: not any(map(is_alive, nodes)))
    finally:
        demo.kill()
        for process_id in filter(is_alive, nodes):
            os.kill(process_id, signal.SIGKILL)
    if stop == signal.SIGTERM:
        assert (demo.returncode, said) == (143, "gtmr: ended by SIGTERM\n")
