# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is written can be read by others; what is killed, cut or damaged can still be read."""

import resource
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from support.written_bags import FLOAT64, ODOMETRY, cdr, new, odometry

from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.metadata import OfferedQos
from gtmr_monitor.bag.reader import (
    DamagedBagWarning,
    TruncatedBagWarning,
    bag_files,
    read_messages,
)
from gtmr_monitor.bag.writer import BagWriter

WRITTEN = [
    item
    for k in range(100)
    for item in (
        ("/odom", cdr(odometry(k * 25_000_000, (1.35, 0.0, k))), 10**9 + k * 25_000_000),
        ("/clearance_residual", cdr(new(FLOAT64, -0.1 - k)), 10**9 + k * 25_000_000 + 1),
    )
]


def write(folder, messages=WRITTEN, chunk=30):
    with BagWriter(folder) as bag:
        bag.add_topic("/odom", ODOMETRY, OfferedQos(depth=5, reliability="best_effort"))
        bag.add_topic("/clearance_residual", FLOAT64, OfferedQos(durability="transient_local"))
        for k, (topic, data, time_ns) in enumerate(messages):
            bag.write(topic, data, time_ns)
            if k % chunk == chunk - 1:
                bag.flush()
    return Path(folder)


def read(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DamagedBagWarning)
        return [(m.topic, m.data, m.log_time_ns) for m in read_messages(path)]


def test_reads_back_what_was_written(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read(write(tmp_path / "bag")) == WRITTEN


def test_rosbags_reads_every_message_type_and_qos(tmp_path):
    with AnyReader([write(tmp_path / "bag")]) as reader:
        read_back = [(c.topic, bytes(data), t) for c, t, data in reader.messages()]
        heights = [
            reader.deserialize(data, c.msgtype).pose.pose.position.z
            for c, _, data in reader.messages()
            if c.topic == "/odom"
        ]
        qos = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}

    assert read_back == WRITTEN
    assert heights == list(range(100))
    assert qos["/odom"][0].depth == 5
    assert qos["/odom"][0].reliability is QosReliability.BEST_EFFORT
    assert qos["/clearance_residual"][0].durability is QosDurability.TRANSIENT_LOCAL


def test_mcap_reads_it_by_its_index(tmp_path):
    [path] = bag_files(write(tmp_path / "bag"))
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        residuals = list(reader.iter_messages(topics="/clearance_residual"))
        header = reader.get_header()
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}

    assert header.profile == "ros2"
    assert summary.statistics.message_count == len(WRITTEN)
    assert {c.compression for c in summary.chunk_indexes} == {"zstd"}
    assert all(c.message_index_offsets for c in summary.chunk_indexes)
    assert [m.data for _, _, m in residuals] == [d for t, d, _ in WRITTEN if t != "/odom"]
    assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
    definition = next(s for s in summary.schemas.values() if s.name == ODOMETRY).data.decode()
    assert "MSG: geometry_msgs/Quaternion" in definition
    assert yaml.safe_load(metadata["rosbag2"]["serialized_metadata"])["version"] == 9


def test_metadata_counts_and_dates_the_messages(tmp_path):
    text = (write(tmp_path / "bag") / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]

    assert information["message_count"] == len(WRITTEN)
    assert information["starting_time"]["nanoseconds_since_epoch"] == WRITTEN[0][2]
    assert information["duration"]["nanoseconds"] == WRITTEN[-1][2] - WRITTEN[0][2]
    assert information["relative_file_paths"] == ["bag_0.mcap"]
    assert isinstance(
        information["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"], list
    )


def test_a_bag_without_messages_is_a_bag(tmp_path):
    folder = write(tmp_path / "bag", messages=[])

    assert read(folder) == []
    with AnyReader([folder]) as reader:
        assert {c.topic for c in reader.connections} == {"/odom", "/clearance_residual"}


def test_closes_properly_when_the_flight_ends_in_an_error(tmp_path):
    bag = BagWriter(tmp_path / "bag")
    bag.add_topic("/odom", ODOMETRY)
    bag.write("/odom", WRITTEN[0][1], 1)
    with pytest.raises(ZeroDivisionError), bag:
        raise ZeroDivisionError

    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 1


def test_a_folder_with_something_in_it_is_refused_and_stays_as_it_is(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")

    with pytest.raises(BagError, match=f"{tmp_path}: .*not empty"):
        BagWriter(tmp_path)

    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_bag_is_never_written_over(tmp_path):
    folder = write(tmp_path / "bag")
    before = {p: p.read_bytes() for p in folder.iterdir()}

    with pytest.raises(BagError):
        BagWriter(folder)

    assert {p: p.read_bytes() for p in folder.iterdir()} == before


def test_an_empty_folder_that_exists_is_taken(tmp_path):
    assert read(write(tmp_path)) == WRITTEN


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "bag").write_text("mine")
    with pytest.raises(BagError, match="bag: "):
        BagWriter(tmp_path / "bag")


def test_a_type_that_jazzy_does_not_have_is_refused(tmp_path):
    with BagWriter(tmp_path / "bag") as bag, pytest.raises(BagError, match="my_msgs/msg/Mine"):
        bag.add_topic("/mine", "my_msgs/msg/Mine")


@pytest.mark.parametrize("name", ["missing", "folder", "text.mcap", "empty.mcap", "photo.png"])
def test_what_is_not_a_bag_is_named_in_one_line(tmp_path, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.mcap").write_text("Dear diary, today I flew around a tower.")
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "photo.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))

    with pytest.raises(BagError) as caught:
        list(read_messages(tmp_path / name))

    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_files_of_a_split_bag_are_read_in_the_order_of_their_numbers(tmp_path):
    part = len(WRITTEN) // 20
    for number in range(20):
        piece = write(tmp_path / f"part{number}", WRITTEN[number * part : (number + 1) * part])
        bag_files(piece)[0].rename(tmp_path / f"flight_{number}.mcap")

    assert read(tmp_path) == WRITTEN


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return bag_files(write(tmp_path_factory.mktemp("whole") / "bag"))[0].read_bytes()


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("scratch") / "torn.mcap"


def test_torn_off_within_its_last_chunk_it_is_read_up_to_there_with_a_warning(whole, scratch):
    scratch.write_bytes(whole[: whole.index(b"serialized_metadata")])

    with pytest.warns(TruncatedBagWarning, match=str(scratch)):
        messages = list(read_messages(scratch))

    assert len(messages) == len(WRITTEN) // 30 * 30


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_torn_off_anywhere_it_gives_the_first_messages_and_nothing_else(whole, scratch, data):
    size = data.draw(st.integers(8, len(whole)))
    scratch.write_bytes(whole[:size])

    messages = read(scratch)

    assert messages == WRITTEN[: len(messages)]
    assert size < len(whole) or len(messages) == len(WRITTEN)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damaged_anywhere_it_never_gives_a_message_that_was_not_written(whole, scratch, data):
    damaged = bytearray(whole)
    position = data.draw(st.integers(8, len(whole) - 1))
    damaged[position] ^= data.draw(st.integers(1, 255))
    scratch.write_bytes(damaged)

    assert set(read(scratch)) <= set(WRITTEN)


WRITE_FOR_EVER = """
import sys, time
from gtmr_monitor.bag.writer import BagWriter
folder, period_s, data = sys.argv[1], 1.0 / float(sys.argv[2]), bytes.fromhex(sys.argv[3])
bag = BagWriter(folder)
bag.add_topic("/odom", "nav_msgs/msg/Odometry")
start = time.monotonic()
k = 0
while True:
    bag.write("/odom", data, k)
    print(time.monotonic(), flush=True)
    k += 1
    time.sleep(max(0.0, start + k * period_s - time.monotonic()))
"""


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [40, 200])
def test_killed_it_loses_less_than_a_second(tmp_path, rate_hz):
    written_s = []
    with subprocess.Popen(
        [sys.executable, "-c", WRITE_FOR_EVER, tmp_path, str(rate_hz), WRITTEN[0][1].hex()],
        stdout=subprocess.PIPE,
        text=True,
    ) as writer:
        for line in writer.stdout:
            written_s.append(float(line))
            if len(written_s) >= 1.9 * rate_hz:
                writer.send_signal(signal.SIGKILL)
                break
        written_s += map(float, writer.stdout.readlines())

    with pytest.warns(TruncatedBagWarning):
        kept = [m.log_time_ns for m in read_messages(tmp_path)]

    assert kept == list(range(len(kept)))
    assert all(written_s[-1] - lost_s < 1.0 for lost_s in written_s[len(kept) :])


WRITE_UNTIL_FULL = """
import sys
from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.writer import BagWriter
bag = BagWriter(sys.argv[1])
bag.add_topic("/odom", "nav_msgs/msg/Odometry")
try:
    for k in range(10**6):
        bag.write("/odom", bytes.fromhex(sys.argv[2]), k)
        if k % 10 == 0:
            bag.flush()
except BagError as error:
    print(k, error, sep="|")
bag.close()
"""


def test_on_a_full_disk_it_keeps_what_it_has(tmp_path):
    done = subprocess.run(
        # -B: a compiled module that is cut off would break every later start of Python.
        [sys.executable, "-B", "-c", WRITE_UNTIL_FULL, tmp_path, WRITTEN[0][1].hex()],
        capture_output=True,
        text=True,
        timeout=60,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000)),
    )
    written, error = done.stdout.strip().split("|")

    assert str(tmp_path) in error
    assert done.returncode == 0, done.stderr
    kept = read(tmp_path)
    assert int(written) - len(kept) <= 10
    assert [time_ns for _, _, time_ns in kept] == list(range(len(kept)))
