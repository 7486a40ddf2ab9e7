# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A recording goes on: after a restart, a kill, a full disk; what it lacks is counted and told."""

import errno
import shutil
from types import SimpleNamespace

import pytest
import yaml
from rosbags.highlevel import AnyReader
from support.written_bags import ODOMETRY, cdr, odometry

from gtmr_monitor import recorder
from gtmr_monitor.bag import writer
from gtmr_monitor.bag.flight import read_flight
from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.metadata import OfferedQos
from gtmr_monitor.bag.reader import DamagedBagWarning, TruncatedBagWarning, read_messages
from gtmr_monitor.recorder import Recorder

FLOAT64 = "std_msgs/msg/Float64"
TOPICS = {"/solve_time": (FLOAT64, OfferedQos()), "/odom": (ODOMETRY, OfferedQos())}


@pytest.fixture
def said():
    return []


@pytest.fixture
def start(tmp_path, said):
    """Start a recorder, always on the same folder."""
    return lambda: Recorder(str(tmp_path / "bag"), TOPICS, said.append)


@pytest.fixture
def disk(monkeypatch):
    """A disk that is full when one says so."""
    disk = SimpleNamespace(full=False)
    write, usage = writer._File.write, shutil.disk_usage

    def write_unless_full(file, data):
        if disk.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(file, data)

    monkeypatch.setattr(writer._File, "write", write_unless_full)
    monkeypatch.setattr(
        recorder.shutil,
        "disk_usage",
        lambda path: SimpleNamespace(free=0) if disk.full else usage(path),
    )
    monkeypatch.setattr(recorder, "RETRY_S", 0.0)
    return disk


def write(recording, numbers):
    for k in numbers:
        recording.write("/solve_time", bytes(12), k)


def fly(recording, numbers, clearance_m=0.35):
    for k in numbers:
        message = odometry(k * 25_000_000, (1.0 + clearance_m, 0.0, 2.0))
        recording.write("/odom", cdr(message), 10**18 + k * 25_000_000)


def kill(recording):
    """Leave its file as a kill does."""
    recording._bag._file._raw.close()


def information(folder):
    text = (folder / "metadata.yaml").read_text()
    return yaml.safe_load(text)["rosbag2_bagfile_information"]


def test_what_is_written_is_in_the_bag(start, said):
    recording = start()
    write(recording, range(3))
    recording.flush()
    assert (recording.active, recording.messages, recording.unwritten) == (True, 3, 0)
    recording.close()
    assert [m.log_time_ns for m in read_messages(recording.folder)] == [0, 1, 2]
    assert said == []


def test_started_again_it_goes_on_in_another_file_of_the_same_bag(start, said, tmp_path):
    first = start()
    fly(first, range(20), clearance_m=0.1)
    first.close()
    again = start()
    fly(again, range(30, 50))
    again.close()

    bag = tmp_path / "bag"
    assert information(bag)["relative_file_paths"] == ["bag_0.mcap", "bag_1.mcap"]
    assert [f["message_count"] for f in information(bag)["files"]] == [20, 20]
    assert information(bag)["message_count"] == 40
    assert information(bag)["duration"]["nanoseconds"] == 49 * 25_000_000
    with AnyReader([bag]) as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count == 40
    flight = read_flight(bag)
    assert flight.residual_statistics["samples"] == 40
    assert flight.residual_statistics["violated"]
    assert flight.coverage.causes == {"recorder stopped": 1}
    assert (first.resumed, again.resumed) == (False, True)
    assert said == []


def test_after_a_kill_the_file_that_was_torn_off_gets_an_end(start, said, tmp_path):
    killed = start()
    fly(killed, range(20))
    killed.flush()
    fly(killed, range(20, 25))
    kill(killed)
    again = start()
    fly(again, range(30, 50))
    with pytest.warns(TruncatedBagWarning):
        assert len(list(read_messages(tmp_path / "bag"))) == 20
    again.close()

    assert information(tmp_path / "bag")["message_count"] == 40
    with AnyReader([tmp_path / "bag"]) as reader:
        assert sum(1 for _ in reader.messages()) == 40
    with pytest.warns(DamagedBagWarning, match="torn off"):
        flight = read_flight(tmp_path / "bag")
    assert flight.coverage.gaps == ((pytest.approx(0.475), pytest.approx(0.75)),)
    assert said == []


def test_killed_before_it_wrote_anything_it_is_in_nobodys_way(start, said, tmp_path):
    kill(start())
    again = start()
    fly(again, range(20))
    again.close()

    with AnyReader([tmp_path / "bag"]) as reader:
        assert sum(1 for _ in reader.messages()) == 20
    assert said == []


def test_a_bag_that_is_being_continued_hides_behind_no_metadata(start, tmp_path):
    start().close()
    assert (tmp_path / "bag" / "metadata.yaml").exists()
    kill(start())

    assert not (tmp_path / "bag" / "metadata.yaml").exists()


def test_a_bag_of_other_topics_is_refused_and_stays_as_it_is(start, tmp_path, said):
    first = start()
    fly(first, range(3))
    first.close()
    before = {p: p.read_bytes() for p in (tmp_path / "bag").iterdir()}

    with pytest.raises(BagError, match="holds a bag of other topics, such as /odom"):
        Recorder(str(tmp_path / "bag"), {"/hex1/odom": (ODOMETRY, OfferedQos())}, said.append)

    assert {p: p.read_bytes() for p in (tmp_path / "bag").iterdir()} == before


def test_a_bag_that_another_recorder_is_writing_is_refused_whole(start, said, tmp_path):
    first = start()
    write(first, range(5))
    first.flush()
    with pytest.raises(BagError, match="another recorder is writing it"):
        start()
    write(first, range(5, 9))
    first.close()
    assert [m.log_time_ns for m in read_messages(tmp_path / "bag")] == list(range(9))
    assert not said


def test_there_is_none_where_something_else_is(tmp_path, said):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(BagError, match="not empty"):
        Recorder(str(tmp_path), TOPICS, said.append)


def test_a_disk_that_is_full_at_the_start_is_told_in_one_line(start, disk, tmp_path):
    disk.full = True

    with pytest.raises(BagError, match=r"bag: cannot write a bag: No space left on device$"):
        start()

    assert list((tmp_path / "bag").iterdir()) == []


@pytest.mark.parametrize("method", ["write", "flush"])
def test_recording_goes_on_when_the_disk_has_room_again(
    start, said, disk, monkeypatch, method, tmp_path
):
    recording = start()
    fly(recording, range(20))
    recording.flush()
    disk.full = True
    fly(recording, range(20, 25))
    if method == "flush":
        recording.flush()
    else:
        monkeypatch.setattr(writer, "FLUSH_PERIOD_S", 0.0)
        recording._bag._flush_period_s = 0.0
        fly(recording, [25])
    assert recording.stopped
    taken_along = recording.unwritten
    assert taken_along == (5 if method == "flush" else 6)
    fly(recording, range(26, 30))
    assert recording.unwritten == taken_along + 4
    assert recording.messages == 20
    disk.full = False
    fly(recording, range(30, 50))
    assert recording.active
    assert recording.messages == 40
    recording.close()

    assert len(said) == 2
    assert said[0].startswith("stopped recording: ")
    assert said[0].endswith("No space left on device")
    assert said[1] == f"recording goes on; {taken_along + 4} messages are missing in between"
    with AnyReader([tmp_path / "bag"]) as reader:
        assert sum(1 for _ in reader.messages()) == 40
    with pytest.warns(DamagedBagWarning):
        coverage = read_flight(tmp_path / "bag").coverage
    assert coverage.gaps == ((pytest.approx(0.475), pytest.approx(0.75)),)


def test_a_bag_that_cannot_be_ended_is_told(start, said, disk):
    recording = start()
    write(recording, range(2))
    disk.full = True
    recording.close()

    (reason,) = said
    assert reason.endswith("No space left on device")
