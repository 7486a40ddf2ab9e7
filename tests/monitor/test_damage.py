# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Of a damaged bag everything is read that is left, and what is missing is told."""

import json
import shutil
import warnings
from collections import Counter

import numpy as np
import pytest
from support.damage import (
    PER_CHUNK,
    PERIOD_S,
    SAMPLES,
    chunk_offsets,
    damage_chunks,
    file_of,
    flip,
    small_bag,
)
from support.written_bags import ODOMETRY, SAMPLE, cdr, copied, flown, odometry

from gtmr_monitor import DamagedBagWarning, read_flight
from gtmr_monitor.bag.losses import Losses
from gtmr_monitor.bag.reader import read_messages
from gtmr_monitor.bag.writer import BagWriter
from gtmr_monitor.bit_flips import flip_bits

DURATION_S = (SAMPLES - 1) * PERIOD_S


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return small_bag(tmp_path_factory.mktemp("whole") / "bag")


@pytest.fixture
def bag(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "bag")


def read(bag):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DamagedBagWarning)
        return read_flight(bag)


def test_a_whole_flight_is_told_to_be_whole(whole):
    coverage = read_flight(whole).coverage

    assert coverage.whole
    assert str(coverage) == "10.0 of 10.0 s"
    assert coverage.as_json() == {
        "covered_s": pytest.approx(DURATION_S),
        "expected_s": pytest.approx(DURATION_S),
        "gaps": [],
        "causes": {},
        "lost_messages": {},
    }


@pytest.mark.parametrize("number", [0, 3, -1])
def test_a_damaged_chunk_is_passed_over_and_what_is_behind_it_is_read(bag, number):
    damage_chunks(bag, number)

    with pytest.warns(DamagedBagWarning, match="damaged chunk"):
        flight = read_flight(bag)

    lost = PER_CHUNK if number >= 0 else SAMPLES % PER_CHUNK
    assert flight.t.size == SAMPLES - lost
    coverage = flight.coverage
    assert coverage.causes == {"damaged chunk": 1}
    assert coverage.lost_messages == dict.fromkeys(
        ("/odom", "/clearance_residual", "/solve_time"), lost
    )
    ((begin, end),) = coverage.gaps
    assert coverage.expected_s == pytest.approx(DURATION_S)
    assert end - begin == pytest.approx((lost + (number == 3)) * PERIOD_S)
    assert coverage.covered_s == pytest.approx(DURATION_S - (end - begin))


def test_two_gaps_are_told_as_the_promise_says(bag):
    coverage = read(damage_chunks(bag, 2, 5)).coverage

    assert str(coverage) == "8.0 of 10.0 s, 2 gaps: 2 × damaged chunk, 240 messages lost"


def test_a_violation_in_front_of_the_damage_is_seen(bag):
    flight = read(damage_chunks(bag, 5))

    assert flight.residual_statistics["violated"]


@pytest.mark.parametrize("field", ["opcode", "length"])
@pytest.mark.parametrize("bit", range(8))
def test_a_record_that_lies_of_itself_hides_only_itself(bag, field, bit):
    at, _ = chunk_offsets(file_of(bag))[4]
    flip(file_of(bag), at + (field == "length"), bit)

    flight = read(bag)

    assert flight.t.size == SAMPLES - PER_CHUNK
    assert flight.coverage.lost_messages["/odom"] == PER_CHUNK


def test_without_its_beginning_it_is_read_from_the_next_chunk_on(bag):
    path = file_of(bag)
    data = path.read_bytes()
    at, length = chunk_offsets(path)[0]
    path.write_bytes(bytes(at + length) + data[at + length :])

    flight = read(bag)

    assert flight.t.size == SAMPLES - PER_CHUNK
    assert flight.coverage.lost_messages["/odom"] == PER_CHUNK
    assert flight.coverage.expected_s == pytest.approx(DURATION_S)


def cut(bag, share):
    data = file_of(bag).read_bytes()
    file_of(bag).write_bytes(data[: int(share * len(data))])


def test_of_a_truncated_file_metadata_tells_how_much_is_lost(bag):
    cut(bag, 0.5)

    flight = read(bag)

    assert flight.truncated
    assert 0 < flight.t.size < SAMPLES
    assert flight.coverage.expected_s == pytest.approx(DURATION_S)
    assert flight.coverage.lost_messages["/odom"] == SAMPLES - flight.t.size
    assert flight.coverage.causes["no end"] == 1


def test_of_a_truncated_file_without_metadata_at_least_the_lack_of_an_end_is_told(bag):
    cut(bag, 0.5)
    (bag / "metadata.yaml").unlink()

    coverage = read(bag).coverage

    assert not coverage.whole
    assert coverage.causes == {"no end": 1}


@pytest.mark.parametrize("end", [1, 20, 300])
def test_a_damaged_index_costs_nothing_and_is_told(bag, end):
    data = bytearray(file_of(bag).read_bytes())
    data[-end:] = bytes(end)
    file_of(bag).write_bytes(data)

    flight = read(bag)

    assert flight.t.size == SAMPLES
    assert flight.coverage.causes == {"damaged index": 1}
    assert flight.coverage.covered_s == pytest.approx(DURATION_S)


@pytest.mark.parametrize(
    "text", ["", "{", "- just\n- a list", "rosbag2_bagfile_information: 3", "\x00\xff"]
)
def test_a_broken_metadata_yaml_costs_nothing_and_is_told(bag, text):
    (bag / "metadata.yaml").write_text(text)

    flight = read(bag)

    assert flight.t.size == SAMPLES
    assert flight.coverage.causes == {"wrong metadata.yaml": 1}


@pytest.mark.parametrize("missing", [0, 1, 2])
@pytest.mark.parametrize("metadata", [True, False])
def test_a_missing_file_of_a_split_bag_is_told(tmp_path, missing, metadata):
    split = tmp_path / "split"
    for number in range(3):
        part = small_bag(tmp_path / f"{number}", samples=100, start=100 * number)
        split.mkdir(exist_ok=True)
        file_of(part).rename(split / f"split_{number}.mcap")
    if metadata:
        names = [f"split_{number}.mcap" for number in range(3)]
        topics = ["/odom", "/clearance_residual", "/solve_time"]
        counts = [{"topic_metadata": {"name": t}, "message_count": 300} for t in topics]
        information = {
            "relative_file_paths": names,
            "message_count": 900,
            "topics_with_message_count": counts,
        }
        text = json.dumps({"rosbag2_bagfile_information": information})
        (split / "metadata.yaml").write_text(text)
    (split / f"split_{missing}.mcap").unlink()

    flight = read(split)

    assert flight.t.size == 200
    if not metadata and missing != 1:
        # Nothing tells of a file in front of all others, or behind them.
        return
    assert flight.coverage.causes["missing file"] == 1
    if metadata:
        assert flight.coverage.lost_messages == dict.fromkeys(topics, 100)
        assert flight.coverage.expected_s == pytest.approx(299 * PERIOD_S)


def test_a_file_of_a_split_bag_that_is_no_bag_is_passed_over(tmp_path):
    split = small_bag(tmp_path / "split", samples=100)
    (split / "split_1.mcap").write_text("not a bag")

    flight = read(split)

    assert flight.t.size == 100
    assert flight.coverage.causes["unreadable file"] == 1


def with_odometry(bag, folder, change):
    """A copy in which the bytes of single odometry messages are changed, by their number."""

    def changed(messages):
        k = Counter()
        for message in messages:
            data = message.data
            if message.topic == "/odom":
                data = change.get(k["odom"], lambda data: data)(data)
                k["odom"] += 1
            yield type(message)(**vars(message) | {"data": data})

    return copied(bag, folder, lambda messages: list(changed(messages)))


def test_an_odometry_that_cannot_be_decoded_is_left_out_and_told(whole, tmp_path):
    flight = read_flight(with_odometry(whole, tmp_path / "bag", {50: lambda data: data[:30]}))

    assert flight.t.size == SAMPLES - 1
    assert flight.coverage.causes == {"undecodable odom": 1}
    assert flight.coverage.gaps == ((pytest.approx(49 * PERIOD_S), pytest.approx(51 * PERIOD_S)),)
    assert any("undecodable odom" in note for note in flight.notes)
    assert str(flight.coverage) == "9.9 of 10.0 s, 1 gap: undecodable odom"


@pytest.mark.parametrize(
    ("k", "stamp_ns"),
    [(0, 10**18), (200, 0), (200, 10**9), (200, 10**18), (SAMPLES - 1, 0), (SAMPLES - 1, 10**18)],
)
def test_a_stamp_that_is_far_from_its_neighbours_hides_nothing_else(whole, tmp_path, k, stamp_ns):
    def misdate(data):
        return data[:4] + np.array(divmod(stamp_ns, 10**9), "<u4").tobytes() + data[12:]

    flight = read_flight(with_odometry(whole, tmp_path / "bag", {k: misdate}))

    assert flight.t.size == SAMPLES - 1
    assert flight.coverage.causes == {"misdated odom": 1}
    assert flight.residual_statistics["violated"]


def test_swapped_odometries_are_sorted_and_the_flight_is_whole(whole, tmp_path):
    def swap(messages):
        a, b = [k for k, m in enumerate(messages) if m.topic == "/odom"][200:202]
        messages[a], messages[b] = messages[b], messages[a]
        return messages

    flight = read_flight(copied(whole, tmp_path / "bag", swap))

    assert flight.t == pytest.approx(read_flight(whole).t)
    assert flight.coverage.whole
    assert flight.late == {"odom": 1}


def test_what_was_never_heard_is_a_gap(tmp_path):
    heard = [(0.025 * k, 0.35) for k in range(400) if not 100 <= k < 120]

    coverage = read_flight(flown(tmp_path / "bag", ("/odom", heard))).coverage

    assert coverage.causes == {"not heard": 1}
    assert coverage.gaps == ((pytest.approx(2.475), pytest.approx(3.0)),)


def test_the_coverage_of_each_vehicle_is_its_own(tmp_path):
    one = [(0.025 * k, 0.35) for k in range(100)]
    other = [(0.025 * k, 0.35) for k in range(100) if k != 50]
    bag = flown(tmp_path / "bag", ("/a/odom", one), ("/b/odom", other))

    assert read_flight(bag, "/a").coverage.whole
    assert str(read_flight(bag, "/b").coverage) == "2.4 of 2.5 s, 1 gap: not heard"


def test_a_bag_without_chunks_is_read_behind_the_damage_too(tmp_path):
    from mcap.well_known import SchemaEncoding
    from mcap.writer import Writer

    path = tmp_path / "plain.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2")
        schema = writer.register_schema(ODOMETRY, SchemaEncoding.ROS2, b"")
        channel = writer.register_channel("/odom", "cdr", schema)
        for k in range(100):
            data = cdr(odometry(k * 25_000_000, (1.35, 0.0, 2.0)))
            writer.add_message(channel, 10**18 + k, data, 10**18 + k, sequence=k)
        writer.finish()
    middle = len(path.read_bytes()) // 2
    data = bytearray(path.read_bytes())
    data[middle : middle + 1000] = b"\xff" * 1000
    path.write_bytes(data)

    flight = read(path)

    assert 96 <= flight.t.size < 100
    told = flight.coverage
    unusable = told.causes.get("undecodable odom", 0) + told.causes.get("not finite odom", 0)
    assert told.lost_messages["/odom"] + unusable == 100 - flight.t.size


def test_no_flipped_bit_hides_anything(tmp_path):
    result = flip_bits(small_bag(tmp_path / "bag", samples=90), tries=100, seed=1)

    assert result.tried == 100
    assert result.outcomes["told"] > 0
    assert result.silent == []


@pytest.mark.slow
def test_no_flipped_bit_hides_anything_of_a_real_flight():
    result = flip_bits(SAMPLE, tries=3, seed=2)

    assert result.silent == []


def test_what_is_missing_is_known_once_everything_is_read(bag):
    losses = Losses()

    with pytest.warns(DamagedBagWarning):
        n = sum(1 for _ in read_messages(damage_chunks(bag, 1), losses))

    assert losses
    assert n + sum(losses.messages.values()) == 3 * SAMPLES


@pytest.mark.slow
def test_a_report_says_what_it_covers_for_every_flight(gtmr, whole, bag, tmp_path):
    damaged = damage_chunks(bag.rename(tmp_path / "damaged"), 6)

    run = gtmr("report", whole, damaged, "--out", tmp_path / "report.html")

    assert run.returncode == 0
    covers = "9.0 of 10.0 s, 1 gap: damaged chunk, 120 messages lost"
    assert f"warning: damaged: covers {covers}" in run.stderr
    assert "bag: covers" not in run.stderr
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"<td>10.0 of 10.0 s</td><td>{covers}</td>" in text
    assert "unknown (damaged): the record is not whole" in text
    assert text.count("% of samples, in what is covered") == 1


def test_where_nothing_is_left_a_report_is_refused(refused, bag, tmp_path):
    damage_chunks(bag, *range(len(chunk_offsets(file_of(bag)))))
    with BagWriter(tmp_path / "empty") as empty:
        empty.add_topic("/odom", ODOMETRY)

    for nothing in (bag, tmp_path / "empty"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DamagedBagWarning)
            message = refused("report", nothing, "--out", tmp_path / "report.html")
        assert str(nothing) in message
