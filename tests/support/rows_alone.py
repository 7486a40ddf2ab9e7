# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Controllers that solve every QP by its rows."""

from contextlib import contextmanager

import pytest

from gtmr_nmpc.compiled import codegen, iteration


@contextmanager
def without_guesses():
    """Make controllers that leave every QP to its rows."""
    flags = ("-O1", "-ffp-contract=fast", "-DGTMR_MAX_GUESSES=0")
    iteration._library.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(codegen, "WRITTEN_FLAGS", flags)
        patch.setattr(codegen, "GENERATED_FLAGS", ("-O1",))
        yield
    iteration._library.cache_clear()
