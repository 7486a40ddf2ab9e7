# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Child processes end with the process that started them, even if that is ended by SIGKILL."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from pathlib import Path
from threading import Thread

PARENT = "GTMR_PARENT"
"""Environment variable: process id with which a child is to end."""
LOOK_S = 1.0
"""Between two looks for the parent [s]."""
GRACE_S = 5.0
"""How long a process may take to end in order once its parent is gone [s]."""
PR_SET_PDEATHSIG = 1
"""Of Linux's prctl(2): the signal that the kernel sends when the parent ends."""


def bound_to_this_process() -> dict[str, str]:
    """Give what to add to the environment of a child, one of ours, that is to end with us.

    It is meant for children started from the main thread: the kernel takes the end of the thread
    that started a child for that of its parent.
    """
    return {PARENT: str(os.getpid())}


def end_with_parent() -> None:
    """Have the kernel send SIGTERM here when the parent ends, if the environment asks for it.

    A parent that is gone already ends this process at once, with exit code 0. Children of this
    process are not bound. Only Linux can do it; elsewhere nothing happens.
    """
    parent = os.environ.pop(PARENT, None)
    if parent is None or sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    # Between the two there may be a debugger or a terminal, with which it ends then.
    if os.getppid() == int(parent):
        Thread(target=_end_after, args=(int(parent),), daemon=True).start()
    elif not _is_alive(int(parent)):
        os._exit(0)


def _end_after(parent: int) -> None:
    """See to it that a signal which came to nothing, as in the middle of a start, ends it too."""
    while os.getppid() == parent:
        time.sleep(LOOK_S)
    time.sleep(GRACE_S)
    os._exit(1)


def _is_alive(process_id: int) -> bool:
    try:
        status = Path(f"/proc/{process_id}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] not in "ZX"
