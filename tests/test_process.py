# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""A node as a process ends cleanly however an interruption reaches it."""

import subprocess
import sys

import pytest

RUN = """
import sys
from gtmr_msgs_py.process import run
from gtmr_msgs_py.suite_node import SuiteNode

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
