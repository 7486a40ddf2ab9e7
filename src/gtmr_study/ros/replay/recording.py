# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a bag tells a replay: states, commands, margins, plans, and when parameters changed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gtmr_monitor.bag.flight import PARAMETER_EVENTS, parameter_value, strictly_later
from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.reader import BagMessage, read_messages
from gtmr_msgs_py import contract, topics
from gtmr_msgs_py.messages import odometry, tightening
from gtmr_msgs_py.messages import path as plan_path
from gtmr_msgs_py.messages.tightening import Tightening
from gtmr_msgs_py.wire import stamps
from gtmr_msgs_py.wire.message_error import MessageError

Array = NDArray[np.float64]
ByTopic = Mapping[str, list[BagMessage]]

PARAMETER_EVENT = "rcl_interfaces/msg/ParameterEvent"
_TYPES = {
    PARAMETER_EVENT,
    *(
        topic.type_name
        for topic in (
            topics.ODOM,
            topics.ROTOR_STATES,
            topics.ROTOR_COMMAND,
            topics.TIGHTENING,
            topics.PREDICTED_PATH,
        )
    ),
}


@dataclass(frozen=True)
class State:
    """A usable odometry message."""

    stamp_ns: int
    """When it was measured [ns]."""
    received_ns: int
    """When it was recorded, Unix time [ns]."""
    rigid_body: Array
    """[p, eta, v, omega]: m, rad, m/s, rad/s; world ENU, omega in body FLU, shape (12,)."""


@dataclass(frozen=True)
class Command:
    """A recorded rotor command, the first of its stamp."""

    stamp_ns: int
    """Stamp of the odometry that it answers [ns]."""
    sent_ns: int
    """When the controller sent it, Unix time [ns]."""
    message: Any
    """trajectory_msgs/JointTrajectory."""


@dataclass(frozen=True)
class Change:
    """Parameters of the controller that took another value, or were first heard of."""

    sent_ns: int
    """When it was told, Unix time [ns]."""
    values: dict[str, Any]
    """By name."""


@dataclass(frozen=True)
class Recording:
    """One vehicle's flight in a bag, after the last reset of the simulation."""

    path: Path
    """The bag."""
    odom: str
    """Topic of the odometry."""
    rotors: str | None
    """Topic of the rotor speeds; None if there is none."""
    node: str
    """Fully qualified name of the controller."""
    states: list[State]
    """By growing stamp; at least one."""
    rotor_states: list[tuple[int, Any]]
    """Stamp [ns] and sensor_msgs/JointState, by growing stamp."""
    commands: list[Command]
    """By growing stamp."""
    margins: list[Tightening]
    """One for each command; empty if that is not so in the bag."""
    plan_ends: list[tuple[int, Array]]
    """When [ns] and where [m], shape (3,), each recorded plan ends."""
    changes: list[Change]
    """In the order in which they were told."""
    notes: list[str] = field(default_factory=list)
    """What a user should know, one sentence each."""

    @property
    def namespace(self) -> str:
        """Of the controller and what it publishes."""
        return self.node.rpartition("/")[0]

    @cached_property
    def renamed(self) -> dict[str, str]:
        """What the topics of odometry and rotor speeds are called in this suite."""
        names = {self.odom: f"{self.namespace}/{topics.ODOM.name}"}
        if self.rotors is not None:
            names[self.rotors] = f"{self.namespace}/{topics.ROTOR_STATES.name}"
        return names

    @property
    def first_parameters(self) -> dict[str, Any]:
        """First known value of every parameter of the controller; empty if none is known."""
        first: dict[str, Any] = {}
        for change in self.changes:
            first = change.values | first
        return first


def read_recording(
    path: str | Path, odom: str | None = None, rotors: str | None = None
) -> Recording:
    """Read what a bag tells a replay.

    Parameters
    ----------
    path : str or pathlib.Path
        A rosbag2 folder, with or without its metadata.yaml, or an MCAP file.
    odom : str, optional
        Topic of the odometry; needed if there are several and none is named ``odom``.
    rotors : str, optional
        Topic of the rotor speeds; ``rotor_states`` beside the odometry if left out.

    Returns
    -------
    Recording

    Raises
    ------
    BagError
        If the path is not a bag, holds no odometry that can be used, or not what is asked for.
    """
    path = Path(path)
    by_type: dict[str, dict[str, list[BagMessage]]] = defaultdict(lambda: defaultdict(list))
    for message in read_messages(path):
        if message.msgtype in _TYPES:
            by_type[message.msgtype][message.topic].append(message)
    of_type = {kind: dict(found) for kind, found in by_type.items()}
    notes: list[str] = []

    odometries = of_type.get(topics.ODOM.type_name, {})
    odom = _odometry_topic(path, odometries, odom, notes)
    namespace = odom.rpartition("/")[0]
    joints = of_type.get(topics.ROTOR_STATES.type_name, {})
    if rotors is not None:
        _require(path, rotors, joints, topics.ROTOR_STATES.type_name)
    else:
        rotors = _beside(namespace, topics.ROTOR_STATES.name, joints)
    commands = of_type.get(topics.ROTOR_COMMAND.type_name, {})
    command = _beside(namespace, topics.ROTOR_COMMAND.name, commands)
    # The odometry of a real vehicle seldom shares its controller's namespace.
    home = namespace if command is None else command.rpartition("/")[0]

    states = _states(path, odometries[odom], notes)
    begin_ns = states[0].received_ns

    def recorded(topic: topics.Topic) -> list[BagMessage]:
        found = of_type.get(topic.type_name, {}).get(f"{home}/{topic.name}", [])
        return [message for message in found if message.log_time_ns >= begin_ns]

    answers = [
        Command(stamps.decode(message.header.stamp), raw.publish_time_ns, message)
        for raw, message in ((raw, raw.decode()) for raw in recorded(topics.ROTOR_COMMAND))
    ]
    answers = strictly_later(_after_reset(answers), key=lambda item: item.stamp_ns)
    speeds = [raw.decode() for raw in joints.get(rotors or "", []) if raw.log_time_ns >= begin_ns]
    stamped = [(stamps.decode(message.header.stamp), message) for message in speeds]
    return Recording(
        path=path,
        odom=odom,
        rotors=rotors,
        node=f"{home}/nmpc",
        states=states,
        rotor_states=strictly_later(stamped, key=lambda item: item[0]),
        commands=answers,
        margins=_margins(recorded(topics.TIGHTENING), len(answers)),
        plan_ends=_plan_ends(recorded(topics.PREDICTED_PATH)),
        changes=_changes(of_type.get(PARAMETER_EVENT, {}), f"{home}/nmpc"),
        notes=notes,
    )


def _odometry_topic(path: Path, found: ByTopic, given: str | None, notes: list[str]) -> str:
    if given is not None:
        _require(path, given, found, topics.ODOM.type_name)
        return given
    ours = [topic for topic in found if topic.rpartition("/")[2] == topics.ODOM.name]
    candidates = sorted(ours or found)
    if not candidates:
        raise BagError(f"{path}: holds no {topics.ODOM.type_name}, so there is nothing to replay")
    if len(candidates) > 1:
        raise BagError(f"{path}: choose the odometry, --odom: {', '.join(candidates)}")
    if not ours:
        notes.append(f"the odometry is that of {candidates[0]}")
    return candidates[0]


def _require(path: Path, topic: str, found: ByTopic, msgtype: str) -> None:
    if topic not in found:
        there = ", ".join(sorted(found)) or "none"
        raise BagError(f"{path}: holds no {msgtype} on {topic}; of that type there is {there}")


def _beside(namespace: str, name: str, found: ByTopic) -> str | None:
    """Find the topic of that name in a namespace, or else the only one of that name."""
    named = [topic for topic in found if topic.rpartition("/")[2] == name]
    if f"{namespace}/{name}" in named:
        return f"{namespace}/{name}"
    return named[0] if len(named) == 1 else None


def _states(path: Path, messages: Iterable[BagMessage], notes: list[str]) -> list[State]:
    states, unusable = [], 0
    frames: dict[tuple[str, str], None] = {}
    for raw in messages:
        message = raw.decode()
        frames[message.header.frame_id, message.child_frame_id] = None
        try:
            stamp_ns, rigid_body = odometry.decode(message)
        except MessageError:
            unusable += 1
            continue
        states.append(State(stamp_ns, raw.log_time_ns, rigid_body))
    if not states:
        raise BagError(f"{path}: holds no odometry that can be used")
    if unusable:
        notes.append(f"{unusable} odometry messages are not finite or have no unit quaternion")
    for world, body in frames:
        if (world, body) != (contract.MAP, contract.BASE_LINK):
            notes.append(f"frames {world!r} and {body!r} are taken as world ENU and body FLU")
    return strictly_later(_after_reset(states), key=lambda state: state.stamp_ns)


def _after_reset(items: list[Any]) -> list[Any]:
    """Leave out what came before time last went back."""
    backwards = (k for k in range(len(items) - 1, 0, -1)
                 if items[k].stamp_ns < items[k - 1].stamp_ns)  # fmt: skip
    return items[next(backwards, 0) :]


def _margins(messages: list[BagMessage], n_commands: int) -> list[Tightening]:
    # They bear no stamp: only their number tells to which command they belong.
    if len(messages) != n_commands:
        return []
    try:
        return [tightening.decode(message.decode()) for message in messages]
    except MessageError:
        return []


def _plan_ends(messages: list[BagMessage]) -> list[tuple[int, Array]]:
    plans = (plan_path.decode(message.decode()) for message in messages)
    return [(int(times_ns[-1]), positions[-1]) for times_ns, positions in plans if len(times_ns)]


def _changes(events: ByTopic, node: str) -> list[Change]:
    changes = []
    for raw in events.get(PARAMETER_EVENTS, []):
        event = raw.decode()
        if event.node == node:
            told = (*event.new_parameters, *event.changed_parameters)
            values = {parameter.name: parameter_value(parameter.value) for parameter in told}
            changes.append(Change(raw.publish_time_ns, values))
    return sorted(changes, key=lambda change: change.sent_ns)
