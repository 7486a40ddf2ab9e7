# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A node as a process ends cleanly however an interruption reaches it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS, SOURCES = ROOT / "scripts", ROOT / "src"

RUN = """
import sys
from gtmr_msgs_py.node.process import run
from gtmr_msgs_py.node.suite_node import SuiteNode

class Interrupted(SuiteNode):
    def start(self):
        {raises}

sys.exit(run(lambda managed: Interrupted("node", managed), []))
"""
# What rclpy makes of a Ctrl-C in the middle of a conversion.
IN_A_CONVERSION = "raise SystemError('take_response returned a result') from KeyboardInterrupt()"


def ended(raises):
    return subprocess.run(
        [sys.executable, "-c", RUN.format(raises=raises)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("raises", ["raise KeyboardInterrupt", IN_A_CONVERSION])
def test_an_interruption_is_a_clean_end(raises):
    run = ended(raises)
    assert (run.returncode, run.stderr) == (0, "")


def test_a_defect_is_not_taken_for_an_interruption():
    run = ended("raise SystemError('lost') from ValueError()")
    assert run.returncode == 1
    assert "lost" in run.stderr


EXECUTABLE = [sys.executable, "-m", "gtmr_msgs_py.start.executable"]


def started(*command, **options):
    return subprocess.run(
        [str(part) for part in command],
        capture_output=True, text=True, timeout=60, check=False, **options,
    )  # fmt: skip


def test_help_says_what_a_node_does_and_how_to_call_it():
    run = started(*EXECUTABLE, "gtmr_sim.node", "lib/gtmr/sim", "--help")
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.startswith("usage: sim [-h] [--managed] [--ros-args")
    assert "Flies a scenario" in run.stdout


@pytest.mark.parametrize("argument", ["--no-such", "mode:=robust"])
def test_an_argument_that_does_not_exist_is_refused(argument):
    run = started(*EXECUTABLE, "gtmr_nmpc.node", "nmpc", argument, "--ros-args", "-p", "seed:=1")
    assert run.returncode == 2
    assert run.stderr.splitlines()[-1] == f"nmpc: error: unrecognized arguments: {argument}"


def test_a_node_without_its_dependencies_says_what_to_do(tmp_path):
    script = SCRIPTS / "monitor"
    (tmp_path / "pydantic.py").write_text(
        "raise ModuleNotFoundError(\"No module named 'pydantic'\")"
    )
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    run = started(script, env=os.environ | {"PYTHONPATH": f"{tmp_path}:{SOURCES}", "PATH": path})
    assert (run.returncode, run.stdout) == (1, "")
    (line,) = run.stderr.splitlines()
    assert line.startswith("error: No module named 'pydantic' in ")
    assert ".venv/bin/activate" in line


def test_a_signal_during_the_imports_is_a_clean_end(tmp_path):
    (tmp_path / "slow.py").write_text("print('here', flush=True)\nimport time\ntime.sleep(60)\n")
    with subprocess.Popen(
        [*EXECUTABLE, "slow", "slow"],
        env=os.environ | {"PYTHONPATH": f"{tmp_path}:{SOURCES}"},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as node:  # fmt: skip
        assert node.stdout.readline() == "here\n"
        node.send_signal(signal.SIGINT)
        _, error = node.communicate(timeout=60)
    assert (node.returncode, error) == (0, "")


BUSY = """
import sys, time
from gtmr_msgs_py.node import process
from gtmr_msgs_py.node.suite_node import SuiteNode

class Busy(SuiteNode):
    def start(self):
        self.create_timer(0.001, self.work)

    def work(self):
        print("at work", flush=True)
        time.sleep(0.3)
        print("done", flush=True)

sys.exit(process.run(lambda managed: Busy("node", managed), [], {executor}))
"""


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["process.PROMPT", "process.SingleThreadedExecutor"])
@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_a_callback_lets_it_finish(stop, executor):
    with subprocess.Popen(
        [sys.executable, "-c", BUSY.format(executor=executor)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as node:  # fmt: skip
        assert node.stdout.readline() == "at work\n"
        node.send_signal(stop)
        rest, error = node.communicate(timeout=60)
    assert (node.returncode, rest, error) == (0, "done\n", "")


def test_without_the_security_that_is_asked_for_no_node_starts(tmp_path):
    enclave = tmp_path / "enclaves"
    enclave.mkdir()
    for name in ("identity_ca.cert.pem", "cert.pem", "key.pem", "permissions_ca.cert.pem",
                 "governance.p7s", "permissions.p7s"):  # fmt: skip
        (enclave / name).touch()
    asked = {"ENABLE": "true", "STRATEGY": "Enforce", "KEYSTORE": str(tmp_path)}
    run = started(
        *(sys.executable, "-c", RUN.format(raises="pass")),
        env=os.environ | {f"ROS_SECURITY_{name}": value for name, value in asked.items()},
    )
    assert run.returncode == 2
    assert "security" in run.stderr
    # Fast DDS says something of its own before, and lets it stand.
    assert run.stderr.splitlines()[-1].startswith("error: ")
    assert "Traceback" not in run.stderr
