# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Starts a node by the name of its module: what ``ros2 run gtmr sim`` comes down to.

Between this and the node's own handling of signals lie its imports, which take a second: a
signal ends them at once, and what is missing is told in one line.
"""

import os
import signal
import sys
from importlib import import_module


def main() -> int:
    """Run the node whose module is the first argument, under the name that is the second.

    The exit code is the node's, or 1 if something cannot be imported.
    """
    module, *sys.argv = sys.argv[1:]
    for stop in (signal.SIGINT, signal.SIGTERM):
        signal.signal(stop, lambda *_: os._exit(0))
    try:
        run = import_module(module).main
    except ImportError as error:
        sys.stderr.write(
            f"error: {error} in {sys.executable}: source the environment that has it "
            "(.venv/bin/activate, install/setup.bash), or pip install -r requirements.txt\n"
        )
        return 1
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return int(run())


if __name__ == "__main__":
    sys.exit(main())
