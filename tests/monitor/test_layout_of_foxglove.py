# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The layout for Foxglove and Lichtblick shows what the sample bag holds."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from support.lichtblick import read_layout

from gtmr_model import CHANNELS, Tower
from gtmr_monitor.bag.reader import read_messages
from gtmr_monitor.report import look
from gtmr_msgs_py import contract
from gtmr_msgs_py.messages import markers
from gtmr_nmpc import ControllerConfig

ROOT = Path(__file__).parents[2]
LAYOUT = (ROOT / "rviz" / "inspection.foxglove.json").read_text(encoding="utf-8")
PATH = re.compile(r"(/[\w/]+)\.(\w+)(?:\[(\d+)\])?")
"""Topic, field and index of a message path."""


@pytest.fixture(scope="module")
def panels():
    return read_layout(LAYOUT)


@pytest.fixture(scope="module")
def messages():
    """Every message of the sample bag, by topic."""
    by_topic = {}
    for message in read_messages(ROOT / "bags" / "sample"):
        by_topic.setdefault(message.topic, []).append(message)
    return by_topic


def panels_in(split):
    if isinstance(split, str):
        return [split]
    return panels_in(split["first"]) + panels_in(split["second"])


def values(path, messages):
    """What a path gives over the whole bag."""
    topic, field, index = PATH.fullmatch(path).groups()
    fields = [getattr(message.decode(), field) for message in messages[topic]]
    return np.array([each if index is None else each[int(index)] for each in fields], float)


def series(panels, panel):
    return {path.label: path.value for path in panels[f"Plot!{panel}"].paths}


def test_the_layout_shows_every_panel(panels):
    assert sorted(panels_in(json.loads(LAYOUT)["layout"])) == sorted(panels)
    for panel in panels.values():
        assert panel.lichtblickPanelTitle == panel.foxglovePanelTitle != ""


@pytest.mark.parametrize("key", ["followingViewWidth", "lineStyle"])
def test_a_key_that_empties_the_plots_or_that_nobody_reads_is_noticed(key):
    plot = '"showLegend"' if key == "followingViewWidth" else '"showLine"'
    with pytest.raises(ValidationError, match=key):
        read_layout(LAYOUT.replace(plot, f'"{key}": 30, {plot}'))


def test_every_curve_and_gauge_has_finite_values_in_the_sample_bag(panels, messages):
    paths = [panels["Gauge!clearance"].path]
    paths += [
        path.value
        for name, panel in panels.items() if name.startswith("Plot!")
        for path in panel.paths if PATH.match(path.value)
    ]  # fmt: skip
    assert len(paths) == 16
    for path in paths:
        shown = values(path, messages)
        assert len(shown) > 100, path
        assert np.isfinite(shown).all(), path


def test_margins_are_plotted_by_the_label_of_their_column_in_the_sample_bag(panels, messages):
    stage, column = messages["/tightening"][0].decode().layout.dim
    labels = column.label.split(",")
    last = (stage.size - 1) * len(labels)
    assert stage.size == ControllerConfig().horizon + 1
    names = {look.MARGIN_LABELS[name]: name for name in (*CHANNELS, "eps_s", "noise")}
    names |= {"gust": "alpha_g", "slack used": "slack"}
    shown = series(panels, "margins")
    assert shown == {
        label: f"/tightening.data[{last + labels.index(name)}]" for label, name in names.items()
    }
    assert sorted(names.values()) == sorted(labels)


def test_the_scene_shows_topics_of_the_sample_bag_and_all_their_namespaces(panels, messages):
    topics = panels["3D!scene"].topics
    assert set(topics) == {"/markers", "/reference", "/predicted_path"} <= set(messages)
    assert all(topic.visible for topic in topics.values())
    shown = topics["/markers"].namespaces
    assert {name for name, each in shown.items() if each.visible} == set(markers.NAMESPACES)
    there = {m.ns for message in messages["/markers"] for m in message.decode().markers}
    assert there == set(markers.NAMESPACES)


def test_the_camera_follows_a_frame_of_the_sample_bag(panels, messages):
    scene = panels["3D!scene"]
    assert (scene.followTf, scene.followMode) == (contract.BASE_LINK, "follow-pose")
    told = [t for message in messages["/tf"] for t in message.decode().transforms]
    assert {(t.header.frame_id, t.child_frame_id) for t in told} == {("map", scene.followTf)}


def test_the_lines_that_must_not_be_crossed_are_drawn(panels):
    assert series(panels, "residual")["safety line"] == "0"
    sampling = float(series(panels, "solve_time")["sampling time"])
    assert sampling == ControllerConfig().sampling_time_s
    assert panels["Gauge!clearance"].minValue == Tower().min_clearance_m
    assert math.isclose(panels["3D!scene"].cameraState.targetOrientation[3], 1.0)
