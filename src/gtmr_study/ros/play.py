# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Publishes a bag with its own timing and /clock, where there is no rosbag2."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Event

import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.reader import BagMessage, read_messages
from gtmr_msgs_py import topics
from gtmr_msgs_py.start.environment import ros_environment
from gtmr_msgs_py.wire import stamps

PLAYED = (topics.ODOM, topics.GROUND_TRUTH, topics.ROTOR_STATES, topics.CLOCK)
"""What is played by default: what a vehicle gives to the controller and the monitor. Their own
topics stay out, so that what is heard of them is their answer to this playback."""
WAIT_S = 5.0
"""How long to wait for listeners before playing to nobody [s]."""
DELIVERY_TIMEOUT_S = 2.0
"""How long the end waits for slow listeners [s]."""
POLL_S = 0.02
"""Between two looks whether somebody listens [s]."""

OnProgress = Callable[[float], None]
"""Told how far into the bag the playback is [s]."""


@dataclass(frozen=True)
class Playlist:
    """What of a bag is to be played."""

    path: Path
    """The bag."""
    types: dict[str, str]
    """Interface name by topic."""
    start_ns: int
    """When the first message was recorded, Unix time [ns]."""
    end_ns: int
    """When the last one was recorded, Unix time [ns]."""

    @property
    def duration_s(self) -> float:
        """From the first message to the last [s]."""
        return stamps.seconds(self.end_ns - self.start_ns)

    def messages(self) -> Iterator[BagMessage]:
        """Read the messages from the bag, in the order in which they were recorded."""
        return (message for message in read_messages(self.path) if message.topic in self.types)


def read_playlist(path: str | Path, everything: bool = False) -> Playlist:
    """Look through a bag for what is to be played: every topic, or what the nodes need.

    Raises BagError if the path is not a bag, or holds nothing to play.
    """
    path = Path(path)
    there: dict[str, str] = {}
    types: dict[str, str] = {}
    times: list[int] = []
    played = {(topic.name.lstrip("/"), topic.type_name) for topic in PLAYED}
    for message in read_messages(path):
        there[message.topic] = message.msgtype
        kind = (message.topic.rpartition("/")[2], message.msgtype)
        if everything or kind in played:
            types[message.topic] = message.msgtype
            times.append(message.log_time_ns)
    if not set(types.values()) - {topics.CLOCK.type_name}:
        names = ", ".join(sorted(there)) or "nothing"
        raise BagError(
            f"{path}: holds no topic named {topics.ODOM.name} or {topics.ROTOR_STATES.name}, but "
            f"{names}; --all plays whatever there is"
        )
    return Playlist(path, types, min(times), max(times))


def play(
    playlist: Playlist,
    rate: float = 1.0,
    loop: bool = False,
    wait_s: float = WAIT_S,
    on_progress: OnProgress | None = None,
    stop: Event | None = None,
) -> list[str]:
    """Publish the messages of a bag at the intervals at which they were recorded.

    /clock is played as recorded; a bag without one gets the time at which its messages were
    recorded, as ``ros2 bag play --clock`` does. Messages go out as the bytes that were recorded,
    ``rate`` times as fast as recorded; a loop begins again at the end, for ever. Before, it waits
    at most ``wait_s`` [s] until somebody listens to odometry and rotor speeds.

    ``stop`` ends the playback when it is set. A KeyboardInterrupt would do so too, but is lost
    where it falls into a callback from C. What a user should know is returned, one sentence each.

    Raises BagError if none of the message types of the playlist is installed.
    """
    stop = stop if stop is not None else Event()
    messages, missing = {}, set()
    for name, kind in playlist.types.items():
        try:
            messages[name] = topics.message_class(kind)
        except ImportError:
            missing.add(kind)
    if not messages:
        raise BagError(f"{playlist.path}: {', '.join(sorted(missing))}: not installed")
    with _node() as node:
        publishers = {
            name: node.create_publisher(message, name, topics.OFFERED)
            for name, message in messages.items()
        }
        clock = None
        if topics.CLOCK.type_name not in playlist.types.values():
            clock = node.create_publisher(Clock, topics.CLOCK.name, topics.OFFERED)
        needed = (topics.ODOM.type_name, topics.ROTOR_STATES.type_name)
        awaited = [publishers[name] for name, kind in playlist.types.items() if kind in needed]
        notes = [f"{kind} is not installed: not played" for kind in sorted(missing)]
        unheard = _wait_for_listeners(awaited, wait_s, stop)
        if unheard:
            notes.append(f"nobody listened at the start to {', '.join(unheard)}")
        while True:
            begin = time.monotonic()
            for message in playlist.messages():
                if message.topic not in publishers:
                    continue
                into_s = stamps.seconds(message.log_time_ns - playlist.start_ns)
                if stop.wait(max(0.0, begin + into_s / rate - time.monotonic())):
                    break
                if clock is not None:
                    clock.publish(Clock(clock=stamps.encode(message.log_time_ns)))
                publishers[message.topic].publish(message.data)
                if on_progress is not None:
                    on_progress(into_s)
            if not loop or stop.is_set():
                break
        for publisher in publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=DELIVERY_TIMEOUT_S))
    return notes


@contextmanager
def _node() -> Iterator[Node]:
    for name, value in ros_environment().items():
        # Who listens may be on another machine: how far to look for it is the user's choice.
        if name != "ROS_AUTOMATIC_DISCOVERY_RANGE":
            os.environ.setdefault(name, value)
    context = Context()
    # Ctrl-C must come as KeyboardInterrupt: nothing spins here that would hear of it otherwise.
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(
        "player", context=context, enable_rosout=False, start_parameter_services=False
    )
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def _wait_for_listeners(publishers: list[Publisher], wait_s: float, stop: Event) -> list[str]:
    """Wait until all topics are listened to; name those that are not in the end."""
    deadline = time.monotonic() + wait_s
    while True:
        unheard = [p.topic_name for p in publishers if p.get_subscription_count() == 0]
        if not unheard or time.monotonic() > deadline or stop.wait(POLL_S):
            return unheard
