# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import subprocess
import sys

from support.processes import is_alive, wait_until

DEAF = """
import signal, time
from gtmr_msgs_py.start import parent
signal.signal(signal.SIGTERM, signal.SIG_IGN)
parent.LOOK_S = parent.GRACE_S = 0.1
parent.end_with_parent()
print(parent.os.getpid(), flush=True)
time.sleep(60)
"""
PARENT = f"""
import os, subprocess, sys, time
from gtmr_msgs_py.start.parent import bound_to_this_process
child = [sys.executable, "-c", {DEAF!r}]
subprocess.Popen(child, env=os.environ | bound_to_this_process())
time.sleep(60)
"""


def test_a_child_that_a_signal_does_not_end_ends_with_its_parent_all_the_same():
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True)
    try:
        child = int(parent.stdout.readline())
        assert is_alive(child)
    finally:
        parent.kill()
        parent.wait()
    wait_until(lambda: not is_alive(child), 10.0)
