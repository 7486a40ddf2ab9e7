# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Environment of all tests, set before any ROS library is loaded, and what many of them use."""

import os
import sys
from types import SimpleNamespace

import pytest
from support import campaign_runs, npm
from support.launch_stubs import launch  # noqa: F401 -- a fixture

from gtmr_msgs_py.start.environment import ros_environment
from gtmr_nmpc.compiled import codegen

os.environ.update(ros_environment())
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"


def pytest_addoption(parser):
    """Let the random cases of tests/fuzz be as many as one likes."""
    parser.addoption("--cases", type=int, default=50, help="cases of each kind in tests/fuzz")


# Real time needs a core for itself: one graph at a time. What is flown once stays together.
TOGETHER = {
    "tests/graph/": "graph",
    "tests/monitor/test_mcap_core.py": "graph",
    "tests/docs/test_site.py": "site",
    "tests/monitor/test_report.py": "report",
    "tests/study/test_campaign": "campaign",
    "tests/study/test_arena": "arena",
    "tests/study/test_calibration.py": "calibration",
    "tests/study/test_reproduction.py": "reproduction",
    "tests/nmpc/test_flights.py": "flights",
}
"""Beginnings of test names, and what runs on one of several workers, one after the other."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Hand out tests; the groups of xdist itself have no effect with pytest 9."""
    from xdist.scheduler import LoadScopeScheduling

    class Together(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            groups = (name for start, name in TOGETHER.items() if nodeid.startswith(start))
            return next(groups, nodeid)

    return Together(config, log)


@pytest.fixture
def gtmr(monkeypatch, capsys):
    """Run the command line in this process: another takes longer to start than most commands."""
    from gtmr_study.cli import app as cli

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


@pytest.fixture
def unoptimised(monkeypatch):
    """Compile the controller, for a problem of one test, in a fifth of the time."""
    for flags in ("GENERATED_FLAGS", "WRITTEN_FLAGS", "UNFUSED_FLAGS"):
        monkeypatch.setattr(codegen, flags, ("-O0",))


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    """Folder of a small campaign that is flown once in a test run."""
    return campaign_runs.flown_in(tmp_path_factory.mktemp("campaign"))


@pytest.fixture(scope="session")
def axe(tmp_path_factory):
    """Source of axe-core, which says what of a page not everybody can read."""
    folder = npm.installed(tmp_path_factory.mktemp("axe"), "axe-core@4.14.1")
    path = folder / "node_modules" / "axe-core" / "axe.min.js"
    return path.read_text(encoding="utf-8")
