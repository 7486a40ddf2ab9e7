# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""Environment of all tests, set before any ROS library is loaded, and what many of them use."""

import os
import sys
from types import SimpleNamespace

import campaign_runs
import pytest

from gtmr_msgs_py.environment import ros_environment

os.environ.update(ros_environment())
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"


@pytest.fixture
def gtmr(monkeypatch, capsys):
    """Run the command line in this process: another takes longer to start than most commands."""
    from gtmr_study import cli

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["gtmr", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        printed = capsys.readouterr()
        return SimpleNamespace(returncode=ended.value.code, stdout=printed.out, stderr=printed.err)

    return run


@pytest.fixture
def refused(gtmr):
    """Run a command that is to be refused, and return its one line."""

    def run(*arguments):
        ended = gtmr(*arguments)
        assert ended.returncode == 2, ended.stderr
        assert ended.stdout == ""
        assert ended.stderr.count("\n") == 1
        return ended.stderr

    return run


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    """Folder of a small campaign that is flown once in a test run."""
    return campaign_runs.flown_in(tmp_path_factory.mktemp("campaign"))
