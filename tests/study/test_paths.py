# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Paths that cannot be used are refused in one line before anything is flown or written."""

import json
import os
import sys

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gtmr_study.cli import app as cli
from gtmr_study.cli.terminal import exit_code_of
from gtmr_study.result_files import InputError, require_folder, require_new_file, write_json

# What is written, by command; all else would be flown for a tenth of a second.
WRITTEN = {
    "fly --json": ["fly", "--duration", "0.1", "--json"],
    "fly --out": ["fly", "--duration", "0.1", "--out"],
    "bench --json": ["bench", "--json"],
    "demo --json": ["demo", "--out", "new", "--json"],
    "demo --out": ["demo", "--out"],
    "campaign --json": ["campaign", "--out", "new", "--json"],
    "campaign --out": ["campaign", "--out"],
    "reproduce --out": ["reproduce", "--quick", "--out"],
    "calibrate --out": ["calibrate", "--sets", "1", "--out"],
    "export-c": ["export-c"],
    "report --out": ["report", "no-bag", "--out"],
    "replay --json": ["replay", "no-bag", "--json"],
    "faults --json": ["faults", "--quick", "--json"],
    "replay --report": ["replay", "no-bag", "--report"],
    "recover --out": ["recover", "no-bag", "--out"],
    "recover --json": ["recover", "no-bag", "--out", "new", "--json"],
}
READ = {
    "fly --vehicle": ["fly", "--duration", "0.1", "--vehicle"],
    "fly --controller": ["fly", "--duration", "0.1", "--controller"],
    "campaign --scenario": ["campaign", "--out", "new", "--scenario"],
    "report": ["report"],
    "replay": ["replay"],
    "play": ["play"],
    "recover": ["recover", "--out", "new"],
}
LONG = "x" * 300
BAD = {
    "a long name": LONG,
    "a long path": "/".join(["x" * 200] * 40),
    "in /proc": "/proc/new",
    "below a file": "file/new",
    "no text": os.fsdecode(b"\xff\xfe/\xff"),
    "line ends": "a\nb/c\n",
    "a loop": "loop/new",
}
ENDINGS = {"fly --out": ".npz", "report --out": ".html", "fly --vehicle": ".yaml",
           "campaign --scenario": ".yaml", "fly --controller": ".py:Own"}  # fmt: skip


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with some obstacles, and the check that nothing else came to be in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    (tmp_path / "loop").symlink_to("loop")
    yield
    assert {path.name for path in tmp_path.iterdir()} == {"file", "loop"}
    assert (tmp_path / "file").read_text() == "mine"


EVERY_COMMAND = [(command, "in /proc") for command in WRITTEN] + [(c, "a long path") for c in READ]
EVERY_PATH = [
    (command, bad)
    for command in ("fly --json", "fly --out", "campaign --out", "fly --vehicle", "report")
    for bad in BAD
    # A folder that is to be made may be called so.
    if command != "campaign --out" or bad not in ("no text", "line ends")
]


@pytest.mark.parametrize(("command", "bad"), sorted({*EVERY_COMMAND, *EVERY_PATH}))
def test_a_path_that_cannot_be_used_is_refused_in_one_line(command, bad, place, refused):
    refused(*(WRITTEN | READ)[command], BAD[bad] + ENDINGS.get(command, ""))


def test_a_file_that_cannot_be_written_in_the_end_is_told_in_one_line(tmp_path, capsys):
    def command():
        write_json(tmp_path / "gone" / "result.json", {})

    assert exit_code_of(command) == 2
    assert "gone" in capsys.readouterr().err


def test_a_link_still_points_where_it_did_and_a_device_is_not_replaced(tmp_path):
    link, target = tmp_path / "link.json", tmp_path / "target.json"
    target.write_text("old")
    link.symlink_to(target)
    write_json(link, {"new": 1})
    assert link.is_symlink()
    assert json.loads(target.read_text()) == {"new": 1}
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_json(pipe, {"new": 1})
    assert json.loads(os.read(reader, 100)) == {"new": 1}
    os.close(reader)
    assert pipe.is_fifo()


def test_a_file_of_a_similar_name_is_not_written_over(tmp_path):
    (tmp_path / "a.json.part").write_text("mine")
    write_json(tmp_path / "a.json", {})
    assert (tmp_path / "a.json.part").read_text() == "mine"
    assert {path.name for path in tmp_path.iterdir()} == {"a.json", "a.json.part"}


NAMES = st.one_of(
    st.text(min_size=1, max_size=300).filter(lambda text: "\0" not in text),
    st.binary(min_size=1, max_size=30).filter(lambda b: b"\0" not in b).map(os.fsdecode),
    st.lists(st.sampled_from(["..", ".", "", "x", LONG, "file"]), min_size=1).map("/".join),
)


@settings(
    max_examples=100,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(name=NAMES)
def test_any_name_can_be_written_or_is_refused_with_nothing_left(name, tmp_path_factory):
    folder = tmp_path_factory.mktemp("names") / "below" / "three" / "levels"
    path = folder.parents[2].joinpath("below", name.lstrip("/"))
    before = set(folder.parents[2].rglob("*"))
    for require in (require_new_file, require_folder):
        try:
            require("--out", path)
        except InputError:
            pass
        except UnicodeEncodeError:
            # No file system has such a name, nor has a command line.
            assert any("\ud800" <= c < "\udc80" or c > "\udcff" for c in name)
    assert set(folder.parents[2].rglob("*")) == before


OPTIONS = {
    "fly": ("--mode", "--seed", "--duration", "--gust", "--vehicle", "--controller", "--zeta"),
    "campaign": ("--trials", "--seed", "--modes", "--duration", "--plan", "--channels",
                 "--levels", "--gust", "--controller", "--scenario", "--workers", "--scheduler"),
    "demo": ("--duration", "--modes"),
    "replay": ("--mode", "--controller", "--vehicle"),
    "play": ("--rate", "--wait"),
    "bench": ("--steps", "--rival-steps", "--qp-steps"),
    "calibrate": ("--target", "--sets", "--trials", "--duration", "--seed", "--workers"),
}  # fmt: skip
# None of them is a value that any option takes.
WORTHLESS = st.one_of(
    st.sampled_from(
        ["", " ", "-", "--", "nan", "inf", "-inf", "-1", "1e999", "9" * 5000, "0x10", "1,,2", "é",
         "\udcff", "a\nb", "a\rb", "\x1b[2J", "{}", "[", "null", "paper.yaml.yaml", "../..", "x:y",
         "x.py:", ".py:X", "/dev/zero.yaml", "%s", "$(true)", "[bold]"]
    ),
    st.text(alphabet="abcxyz-_=:[]{}é\n\t\\'\"", max_size=20),
)  # fmt: skip


@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_any_argument_gives_one_line_and_exit_code_2(data, capsys, tmp_path_factory):
    command = data.draw(st.sampled_from(sorted(OPTIONS)))
    option = data.draw(st.sampled_from(OPTIONS[command]))
    value = data.draw(WORTHLESS)
    arguments = [command, option, value, "--json", "/proc/none"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("any"))
        patch.setattr(sys, "argv", ["gtmr", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
    printed = capsys.readouterr()
    assert ended.value.code == 2, (arguments, printed.err)
    assert printed.err.count("\n") == 1, (arguments, printed.err)
