# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Rotor speeds as sensor_msgs/JointState: Hz in the state, rad/s in the message."""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import JointState

from gtmr_msgs_py.contract import RAD_PER_TURN, rotor_names
from gtmr_msgs_py.wire import stamps
from gtmr_msgs_py.wire.fixed_cdr import FixedCdr
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_msgs_py.wire.reading import read


def decode(msg: JointState, n_rotors: int) -> tuple[int, NDArray[np.float64]]:
    """Read when rotor speeds were measured [ns], and the speeds [Hz], shape (N_p,).

    They are in the order of the state whatever the order of the names; without names they are
    taken in order. Raises MessageError if rotors are missing, or a speed is not finite.
    """
    xi = np.array(msg.velocity) / RAD_PER_TURN
    names = list(msg.name)
    expected = rotor_names(n_rotors)
    if len(xi) != n_rotors or (names and sorted(names) != sorted(expected)):
        raise MessageError(
            f"rotor_states has {len(xi)} speeds for {names}: expected {', '.join(expected)}",
            "vehicle",
        )
    if names and names != expected:
        xi = xi[[names.index(name) for name in expected]]
    return stamps.decode(msg.header.stamp), _finite(xi)


def pack(stamp_ns: int, xi: ArrayLike) -> bytes:
    """Make CDR bytes of a sensor_msgs/JointState, of rotor speeds [Hz].

    The stamp [ns] is that of the odometry they belong to.
    """
    speeds = RAD_PER_TURN * np.asarray(xi, dtype=float)
    return _layout(len(speeds)).pack(stamp_ns, speeds)


def unpack(data: bytes, n_rotors: int) -> tuple[int, NDArray[np.float64]]:
    """Read rotor speeds as `decode` does, out of CDR bytes from anywhere; fast those of `pack`.

    Raises MessageError for what `decode` refuses, and for what is no such message.
    """
    unpacked = _layout(n_rotors).unpack(data)
    if unpacked is None:
        return decode(read(data, JointState), n_rotors)
    stamp_ns, speeds = unpacked
    return stamp_ns, _finite(speeds / RAD_PER_TURN)


def _finite(xi: NDArray[np.float64]) -> NDArray[np.float64]:
    if not np.isfinite(xi).all():
        raise MessageError(f"rotor_states is not finite: {xi} Hz")
    return xi


@cache
def _layout(n_rotors: int) -> FixedCdr:
    layout = FixedCdr()
    layout.header()
    layout.strings(rotor_names(n_rotors))
    # Neither positions nor efforts.
    layout.uint32(0, n_rotors)
    layout.float64(n_rotors)
    layout.uint32(0)
    return layout
