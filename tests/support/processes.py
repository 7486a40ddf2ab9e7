"""Processes of this machine, as /proc tells of them."""

import time
from pathlib import Path

DEADLINE_S = 60.0


def _status(process_id):
    """State and parent of a process, or None if there is none."""
    try:
        text = Path(f"/proc/{process_id}/stat").read_text(errors="replace")
    except OSError:
        return None
    state, parent = text.rpartition(")")[2].split()[:2]
    return state, int(parent)


def is_alive(process_id):
    status = _status(process_id)
    return status is not None and status[0] not in "ZX"


def descendants(process_id):
    """Ids of the living children of a process, and of theirs."""
    children = {}
    for entry in Path("/proc").glob("[0-9]*"):
        status = _status(entry.name)
        if status is not None and status[0] not in "ZX":
            children.setdefault(status[1], []).append(int(entry.name))
    found = []
    todo = [process_id]
    while todo:
        own = children.get(todo.pop(), [])
        found += own
        todo += own
    return found


def command_line(process_id):
    try:
        return Path(f"/proc/{process_id}/cmdline").read_text(errors="replace").split("\0")
    except OSError:
        return []


def running(process_id, modules):
    """Ids of the descendants of a process that run one of some Python modules."""
    return [p for p in descendants(process_id) if set(modules) & set(command_line(p))]


def wait_until(condition, deadline_s=DEADLINE_S):
    """Wait until something is so; TimeoutError if it is not in time."""
    end = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"not so within {deadline_s} s")
        time.sleep(0.02)
