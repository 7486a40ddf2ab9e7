# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a message that cannot be used raises."""

from __future__ import annotations

from typing import Literal, get_args

Cause = Literal["undecodable", "frame", "vehicle", "late", "future", "jump"]
"""Why a message is dropped: it is no such message, or its numbers mean nothing; it is of a foreign
frame, of another vehicle, of the past, of an impossible future; it says what no vehicle can do."""
CAUSES: tuple[Cause, ...] = get_args(Cause)
"""All of them, in the order in which they are told."""


class MessageError(ValueError):
    """A message that breaks the contract; the text is one line naming field and value."""

    def __init__(self, reason: str, cause: Cause = "undecodable") -> None:
        super().__init__(reason)
        self.cause: Cause = cause
        """By which it is counted."""
