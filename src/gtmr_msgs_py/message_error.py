# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""What a message that cannot be used raises."""


class MessageError(ValueError):
    """A message that breaks the contract; the text is one line naming field and value."""
