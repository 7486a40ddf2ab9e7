# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Messages as bytes that are none: whatever comes, a decoder refuses it by a MessageError."""

import os
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from gtmr_model import Vehicle
from gtmr_msgs_py.messages import odometry, rotor_command, rotor_states
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_study.faults.fault import Fault, Outcome, Rng
from gtmr_study.faults.hostile import damaged

N_ROTORS = 6
PERIOD_NS = 25_000_000


@lru_cache(maxsize=1)
def good() -> dict[str, bytes]:
    """Make one of each message of the control loop."""
    x = np.r_[1.35, 0.0, 2.0, np.zeros(9), Vehicle.paper().hover_rotor_speeds_hz]
    xi, u = np.tile(x[12:], (21, 1)), np.zeros((20, N_ROTORS))
    return {
        "odom": odometry.pack(10**9, x),
        "rotor_states": rotor_states.pack(10**9, x[12:]),
        "rotor_command": rotor_command.pack(10**9, PERIOD_NS, xi, u),
    }


def decoders() -> dict[str, Callable[[bytes], Any]]:
    """Give what reads them in the nodes."""
    reader = rotor_command.Reader(N_ROTORS)
    reader.unpack(good()["rotor_command"])
    return {
        "odom": odometry.unpack,
        "rotor_states": lambda data: rotor_states.unpack(data, N_ROTORS),
        "rotor_command": reader.unpack,
    }


def refused(rng: Rng) -> Outcome:
    """Damage a message, and read it: it gives finite numbers, or a MessageError."""
    name = str(rng.choice(list(good())))
    of = str(rng.choice(list(good()))) if rng.random() < 0.1 else name
    data = damaged(good()[of], rng)
    try:
        read = decoders()[name](data)
    except MessageError:
        return Outcome(True)
    except Exception as error:
        return Outcome(False, why=f"{name}: {type(error).__name__}")
    numbers = np.r_[read.xi.ravel(), read.u.ravel()] if name == "rotor_command" else read[1]
    return Outcome(bool(np.isfinite(numbers).all()), why=f"{name}: a number that is none")


def faults() -> list[Fault]:
    """Give the faults on messages as bytes."""
    promise = "is refused by a MessageError, or gives finite numbers"
    return [Fault("message-damaged", promise, "bytes", 10000, 500, quietly)]


def quietly(rngs: Sequence[Rng]) -> Iterator[Outcome]:
    """Try once for each, without what the middleware's C++ prints of every such message."""
    before, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield from [refused(rng) for rng in rngs]
    finally:
        os.dup2(before, 2)
        os.close(before)
        os.close(nowhere)
