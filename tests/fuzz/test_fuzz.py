# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Whatever comes in is taken or refused: messages, YAML, command lines and bags by random numbers.

Every case has a number and is the same each time. A few of each are tried in every run; all that
were tried once are tried again with ``pytest tests/fuzz --cases 10000``.
"""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_study.faults import catalogue
from gtmr_study.faults.hostile import path_name
from gtmr_study.ros.faults import messages
from gtmr_study.ros.faults.messages import decoders, good

pytestmark = pytest.mark.slow

FILES = [fault for fault in catalogue.faults().values() if fault.place == "files"]
BAD = ("", "x", "-1", "nan", "inf", "1e999", "-", "0x10", "1,5", "\u0663.", "1e-400")
"""No duration, and no number of trials."""
REFUSED = {
    "campaign": "--trials",
    "export-c": "--controller",
    "faults": "",
    "fly": "--duration",
    "recover": "",
    "replay": "",
    "report": "",
    "reproduce": "--trials",
}
"""What of each command is given a value that is refused; an argument where it is no option."""
OPTIONS = {
    "campaign": ("--seed", "--out", "--modes", "--workers", "--json"),
    "export-c": ("--out",),
    "faults": ("--json",),
    "fly": ("--mode", "--seed", "--gust", "--vehicle", "--controller", "--out", "--json"),
    "recover": ("--out",),
    "replay": ("--mode", "--json", "--vehicle"),
    "report": ("--out", "--vehicle"),
    "reproduce": ("--seed", "--out", "--scenario"),
}
"""What else they may be given."""


def cases(pytestconfig, divisor=1):
    return range(max(1, pytestconfig.getoption("cases") // divisor))


@given(st.data())
@settings(max_examples=200, deadline=None, derandomize=True, database=None)
def test_bytes_that_hypothesis_thinks_of_are_refused_by_a_message_error(data):
    name = data.draw(st.sampled_from(sorted(good())))
    whole = good()[name]
    at = data.draw(st.integers(0, len(whole)))
    given_bytes = whole[:at] + data.draw(st.binary(max_size=64)) + whole[at:]
    cut = given_bytes[: data.draw(st.integers(0, len(given_bytes)))]
    with suppress(MessageError):
        decoders()[name](cut)


def test_damaged_messages_are_refused_by_a_message_error(pytestconfig):
    (fault,) = messages.faults()

    assert [o.why for o in fault.outcomes(cases(pytestconfig)) if not o.held] == []


@pytest.mark.parametrize("fault", FILES, ids=lambda fault: fault.name)
def test_files_are_read_as_far_as_they_go_or_refused_in_one_line(fault, pytestconfig):
    # A bag is written anew for each case: five kinds of damage share the number.
    tried = cases(pytestconfig, 5 if fault.name.startswith("bag") else 1)

    assert [o.why for o in fault.outcomes(tried) if not o.held] == []


def test_command_lines_that_mean_nothing_are_refused_in_one_line(
    pytestconfig, gtmr, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for k in cases(pytestconfig):
        rng = np.random.default_rng(k)
        command = str(rng.choice(list(REFUSED)))
        option = REFUSED[command]
        bad = str(rng.choice(BAD)) if option in ("--duration", "--trials") else path_name(rng)
        arguments = [option, bad] if option else [f"nowhere/{bad}"]
        for _ in range(int(rng.integers(0, 3))):
            value = path_name(rng) if rng.random() < 0.5 else str(rng.choice(BAD))
            arguments += [str(rng.choice(OPTIONS[command])), value]

        ended = gtmr(command, *arguments)

        assert ended.returncode == 2, (k, command, arguments, ended.stderr)
        lines = 1 + sum(argument.count("\n") for argument in arguments)
        assert 1 <= ended.stderr.count("\n") <= lines, (k, command, arguments, ended.stderr)
