# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Bags written message by message, without ROS: odometry that tells what is asked of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gtmr_monitor.bag.format import typestore
from gtmr_monitor.bag.reader import read_messages
from gtmr_monitor.bag.writer import BagWriter

STORE = typestore()
ODOMETRY = "nav_msgs/msg/Odometry"
FLOAT64 = "std_msgs/msg/Float64"
SAMPLE = Path(__file__).parents[2] / "bags" / "sample"
"""The bag of 10 s that comes with the suite."""


def new(msgtype, *fields):
    return STORE.types[msgtype](*fields)


def cdr(message):
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def odometry(stamp_ns, position):
    """At rest and level."""
    zero = new("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    pose = new(
        "geometry_msgs/msg/Pose",
        new("geometry_msgs/msg/Point", *map(float, position)),
        new("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0),
    )
    stamp = new("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
    return new(
        ODOMETRY,
        new("std_msgs/msg/Header", stamp, "map"),
        "base_link",
        new("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
        new(
            "geometry_msgs/msg/TwistWithCovariance",
            new("geometry_msgs/msg/Twist", zero, zero),
            np.zeros(36),
        ),
    )


def flown(folder, *vehicles):
    """A bag of odometry that comes 40 times a second.

    A vehicle is a topic with (stamp [s], clearance [m]) of each message, in order of arrival.
    """
    with BagWriter(folder) as bag:
        for topic, samples in vehicles:
            bag.add_topic(topic, ODOMETRY)
            for k, (stamp_s, clearance_m) in enumerate(samples):
                message = odometry(round(1e9 * stamp_s), (1.0 + clearance_m, 0.0, 2.0))
                bag.write(topic, cdr(message), 10**18 + k * 25_000_000)
    return folder


def copied(bag, folder, change):
    """A bag of the messages of another, changed as a whole: a list in, a list out."""
    messages = change(list(read_messages(bag)))
    with BagWriter(folder) as copy:
        for topic, msgtype in {m.topic: m.msgtype for m in messages}.items():
            copy.add_topic(topic, msgtype)
        for m in messages:
            copy.write(m.topic, m.data, m.log_time_ns, m.publish_time_ns)
    return folder
