# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command line ``gtmr``."""

import re
import signal
import sys

from gtmr_msgs_py.start.parent import end_with_parent

__all__ = ["main"]


def main() -> None:
    """Run the command line; a part that was not installed is named in one line, exit code 2.

    SIGTERM ends it as orderly as Ctrl-C does, with exit code 143.
    """
    end_with_parent()
    signal.signal(signal.SIGTERM, _end)
    try:
        from gtmr_study.cli.app import main as run

        run()
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        extra = _extra_with(module)
        if extra is None:
            raise
        command = " ".join(["gtmr", *sys.argv[1:2]])
        sys.stderr.write(f"{command} needs {module}: pip install 'gtmr[{extra}]'\n")
        sys.exit(2)


def _end(number: int, _: object) -> None:
    """Unwind, so that child processes end and files are whole; more signals change nothing."""
    signal.signal(number, signal.SIG_IGN)
    sys.stderr.write(f"gtmr: ended by {signal.Signals(number).name}\n")
    sys.exit(128 + number)


def _extra_with(module: str) -> str | None:
    """Name the optional part of this package that brings a module."""
    # Only now: it takes as long to import as all else of this module.
    from importlib.metadata import PackageNotFoundError, requires

    try:
        declared = requires("gtmr") or []
    except PackageNotFoundError:
        return None
    for line in declared:
        if found := re.match(rf"{re.escape(module)}\b.*extra == [\"'](\w+)[\"']", line):
            return found[1]
    return None
