# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Processes of this machine, as /proc tells of them."""

import ipaddress
import sys
import time
from contextlib import suppress
from pathlib import Path

DEADLINE_S = 60.0
LISTENS, UNCONNECTED = "0A", "07"
"""States of a socket that takes what anybody sends."""


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


def open_addresses(process_id):
    """Addresses at which a process can be reached, as the kernel lists them: (kind, address)."""
    inodes = set()
    for entry in Path(f"/proc/{process_id}/fd").iterdir():
        with suppress(OSError):
            inodes.add(str(entry.readlink()))
    found = set()
    for kind in ("tcp", "tcp6", "udp", "udp6"):
        lines = Path(f"/proc/{process_id}/net/{kind}").read_text().splitlines()[1:]
        for fields in map(str.split, lines):
            waits = fields[3] == LISTENS or (kind.startswith("udp") and fields[3] == UNCONNECTED)
            if waits and f"socket:[{fields[9]}]" in inodes:
                found.add((kind, _address(fields[1].partition(":")[0])))
    return found


def _address(digits):
    """Read an address as /proc writes it: hexadecimal, in words of this machine's byte order."""
    words = [digits[i : i + 8] for i in range(0, len(digits), 8)]
    packed = b"".join(int(word, 16).to_bytes(4, sys.byteorder) for word in words)
    address = ipaddress.ip_address(packed)
    return getattr(address, "ipv4_mapped", None) or address


def is_open_to_the_network(address):
    """Whether others can reach it; a group of addresses is joined on loopback alone, then."""
    return not (address.is_loopback or address.is_multicast)
