# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Messages out of bytes that anybody may have sent."""

from __future__ import annotations

from typing import TypeVar

from rclpy.serialization import deserialize_message

from gtmr_msgs_py.wire.message_error import MessageError

M = TypeVar("M")


def read(data: bytes, message_class: type[M]) -> M:
    """Make a message of CDR bytes; raises MessageError if they are none of this class."""
    try:
        message: M = deserialize_message(data, message_class)
    # The middleware's errors are of many kinds, and some are of no documented one.
    except Exception as error:
        reason = " ".join(str(error).split())[:120]
        raise MessageError(
            f"{len(data)} bytes are no {message_class.__name__}: {reason}"
        ) from None
    return message
