# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The bag that comes with the repository: one flight in all three modes, with nothing late."""

import importlib.util
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from gtmr_monitor.bag.reader import read_messages
from gtmr_monitor.bag.vehicles import read_recording
from gtmr_msgs_py import contract
from gtmr_msgs_py.messages import odometry
from gtmr_msgs_py.wire import stamps
from gtmr_nmpc import MODES
from gtmr_study.ros.replay.run import replay

ROOT = Path(__file__).parents[2]
BAG = ROOT / "bags" / "sample"


@pytest.fixture(scope="module")
def script():
    path = ROOT / "bench" / "sample_bag.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_nothing_was_late_or_lost(script):
    assert script.faults(BAG) == []


def test_a_replay_follows_the_switches_and_gives_the_recorded_commands():
    replayed = replay(read_recording(BAG))
    modes = [step.mode for step in replayed.steps]
    assert [modes[0], *(b for a, b in pairwise(modes) if a != b)] == list(MODES)
    assert max(step.difference for step in replayed.steps) < 1e-9
    assert len(replayed.steps) > 800
    assert not replayed.notes


def test_frames_are_there_from_the_start_and_the_vehicle_s_is_where_it_is():
    by_topic, first = {}, None
    for message in read_messages(BAG):
        first = first or message.topic
        by_topic.setdefault(message.topic, []).append(message.decode())
    assert first == contract.TF_STATIC.name
    (tower,) = by_topic["/tf_static"][0].transforms
    assert (tower.header.frame_id, tower.child_frame_id) == ("map", contract.TOWER_FRAME)
    truth = {
        stamps.decode(message.header.stamp): odometry.decode(message)[1][:3]
        for message in by_topic["/ground_truth"]
    }
    told = [message.transforms[0] for message in by_topic["/tf"]]
    stamped = [stamps.decode(each.header.stamp) for each in told]
    assert np.diff(stamped).max() <= 100_000_000
    for stamp_ns, each in zip(stamped, told, strict=True):
        at = each.transform.translation
        assert (at.x, at.y, at.z) == pytest.approx(truth[stamp_ns])


def test_the_vehicle_is_drawn_often_enough_to_see_it_move():
    drawn = [m for m in read_messages(BAG) if m.topic == "/markers"]
    sets = [m for m in drawn if any(each.ns == "body" for each in m.decode().markers)]
    assert np.median(np.diff([m.log_time_ns for m in sets])) < 60_000_000
