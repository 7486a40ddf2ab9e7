# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A recording that fails says so once, keeps what it has and counts what it lacks."""

import pytest

from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.metadata import OfferedQos
from gtmr_monitor.bag.reader import TruncatedBagWarning, read_messages
from gtmr_monitor.bag.writer import BagWriter
from gtmr_monitor.recorder import Recorder

FLOAT64 = "std_msgs/msg/Float64"


@pytest.fixture
def said():
    return []


@pytest.fixture
def recording(tmp_path, said):
    recording = Recorder(str(tmp_path / "bag"), said.append)
    recording.add_topic("/solve_time", FLOAT64, OfferedQos())
    return recording


def write(recording, times_ns):
    for time_ns in times_ns:
        recording.write("/solve_time", bytes(12), time_ns)


def test_what_is_written_is_in_the_bag(recording, said):
    write(recording, range(3))
    recording.flush()
    assert (recording.active, recording.messages, recording.unwritten) == (True, 3, 0)
    recording.close()
    assert [m.log_time_ns for m in read_messages(recording.folder)] == [0, 1, 2]
    assert said == []


def full(bag, *_):
    bag._give_up(OSError(28, "No space left on device"))


@pytest.mark.parametrize("method", ["write", "flush"])
def test_a_full_disk_ends_it_and_what_comes_later_is_counted(recording, said, monkeypatch, method):
    write(recording, range(2))
    recording.flush()
    with monkeypatch.context() as disk:
        disk.setattr(BagWriter, method, full)
        write(recording, [2])
        recording.flush()
    write(recording, [3, 4])

    (reason,) = said
    assert reason.startswith("stopped recording: ")
    assert reason.endswith("No space left on device")
    assert not recording.active
    assert recording.unwritten == 3
    assert recording.messages == recording.size_bytes == 0
    with pytest.warns(TruncatedBagWarning):
        assert [m.log_time_ns for m in read_messages(recording.folder)] == [0, 1]


def test_a_bag_that_cannot_be_ended_is_told(recording, said, monkeypatch):
    monkeypatch.setattr(BagWriter, "close", full)
    recording.close()

    (reason,) = said
    assert reason.endswith("No space left on device")


def test_there_is_none_where_something_is(tmp_path, said):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(BagError, match="not empty"):
        Recorder(str(tmp_path), said.append)
