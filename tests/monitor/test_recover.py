# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is left of a damaged bag becomes a whole one, which says what it lacks."""

import json
import shutil
import warnings

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from support.damage import PER_CHUNK, SAMPLES, chunk_offsets, damage_chunks, file_of, small_bag

from gtmr_monitor import DamagedBagWarning, read_flight
from gtmr_monitor.bag.reader import read_messages
from gtmr_monitor.recover import recover

TOPICS = {"/odom", "/clearance_residual", "/solve_time"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return small_bag(tmp_path_factory.mktemp("whole") / "bag")


@pytest.fixture
def damaged(whole, tmp_path):
    return damage_chunks(shutil.copytree(whole, tmp_path / "damaged"), 0, 6)


def read(bag):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DamagedBagWarning)
        return read_flight(bag)


def test_the_bag_is_whole_to_all_who_read_bags(gtmr, damaged, tmp_path):
    out = tmp_path / "out"

    run = gtmr("recover", damaged, "--out", out, "--json", tmp_path / "r.json")

    assert run.returncode == 0
    assert "2 × damaged chunk" in run.stderr
    left = 3 * (SAMPLES - 2 * PER_CHUNK)
    with AnyReader([out]) as reader:
        assert reader.message_count == left
        assert set(reader.topics) == TOPICS
        assert sum(1 for _ in reader.messages()) == left
    with file_of(out).open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary.statistics.message_count == left
    assert {c.compression for c in summary.chunk_indexes} == {"zstd"}
    assert all(c.message_index_offsets for c in summary.chunk_indexes)
    assert all(b"float64" in schema.data for schema in summary.schemas.values())
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["messages"] == left
    assert result["lost_messages"] == dict.fromkeys(TOPICS, 2 * PER_CHUNK)
    assert result["vehicles"]["/odom"]["coverage"] == read(out).coverage.as_json()


def test_it_covers_what_the_damaged_bag_covers_and_says_so(damaged, tmp_path):
    with pytest.warns(DamagedBagWarning):
        recover(damaged, tmp_path / "out")

    before, after = read(damaged), read(tmp_path / "out")

    assert after.t == pytest.approx(before.t)
    assert after.p == pytest.approx(before.p)
    assert after.coverage == before.coverage


def test_of_a_killed_recorder_it_has_an_end_and_says_that_it_was_torn_off(whole, tmp_path):
    torn = tmp_path / "torn.mcap"
    data = file_of(whole).read_bytes()
    torn.write_bytes(data[: len(data) // 2])

    with pytest.warns(DamagedBagWarning):
        recover(torn, tmp_path / "out")
    flight = read(tmp_path / "out")

    assert not flight.truncated
    assert flight.coverage.causes == {"torn off": 1}
    assert flight.t.size == read(torn).t.size


def test_a_whole_bag_comes_out_whole(gtmr, whole, tmp_path):
    run = gtmr("recover", whole, "--out", tmp_path / "out")

    assert (run.returncode, run.stderr) == (0, "")
    assert read_flight(tmp_path / "out").coverage.whole
    data = [[(m.topic, m.data) for m in read_messages(bag)] for bag in (whole, tmp_path / "out")]
    assert data[0] == data[1]


def test_nothing_is_written_over(refused, damaged, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")

    assert "--out" in refused("recover", damaged, "--out", tmp_path / "out")

    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"


def test_where_nothing_is_left_it_is_refused_and_leaves_nothing(refused, damaged, tmp_path):
    damage_chunks(damaged, *(k for k in range(11) if k not in (0, 6)))
    assert len(chunk_offsets(file_of(damaged))) == 11

    message = refused("recover", damaged, "--out", tmp_path / "out")

    assert "nothing is left" in message
    assert not (tmp_path / "out").exists()
