# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What writing and reading a bag share: its message types and its errors."""

from functools import lru_cache

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore


class BagError(ValueError):
    """A bag that cannot be written or read; the message is one line naming the path."""


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """Return the message types of ROS 2 Jazzy; needs no ROS."""
    return get_typestore(Stores.ROS2_JAZZY)


def without_tail(data: bytes, msgtype: str) -> bytes:
    """Cut off the padding that Fast DDS leaves after a message that it serialises in memory.

    It reserves padding in front of elements that an empty sequence does not have, and hands it
    out at the end of the buffer; strict readers take that for a damaged message. What comes over
    the wire has no such tail.
    """
    definition = typestore().get_msgdef(msgtype)
    _, end = definition.deserialize_cdr_le(data[4:], 0, definition.cls, typestore())
    return data[: 4 + end]
