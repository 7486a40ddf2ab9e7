# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The states of a recorded flight that a controller can be fed with."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.recording import Recording
from gtmr_msgs_py.messages import odometry
from gtmr_msgs_py.wire.message_error import MessageError


@dataclass(frozen=True)
class State:
    """A usable odometry message."""

    stamp_ns: int
    """When it was measured [ns]."""
    received_ns: int
    """When it was recorded, Unix time [ns]."""
    rigid_body: NDArray[np.float64]
    """[p, eta, v, omega]: m, rad, m/s, rad/s; world ENU, omega in body FLU, shape (12,)."""


def usable_states(recording: Recording, notes: list[str]) -> list[State]:
    """Read the states, by growing stamp; what is left out is noted.

    Raises BagError if none can be used.
    """
    states = []
    for item in recording.odometry:
        try:
            stamp_ns, rigid_body = odometry.decode(item.message)
        except MessageError:
            continue
        states.append(State(stamp_ns, item.received_ns, rigid_body))
    if not states:
        raise BagError(f"{recording.path}: holds no odometry that can be used")
    unusable = len(recording.odometry) - len(states)
    if unusable:
        notes.append(f"{unusable} odom messages have no unit quaternion, or no finite twist")
    return states
