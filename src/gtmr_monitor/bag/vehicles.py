# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Finding the flights of a bag: which vehicles it holds, and which topics are whose."""

import math
from pathlib import Path
from typing import Any

from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.reader import BagMessage, is_whole, read_messages
from gtmr_monitor.bag.recording import Recorded, Recording, changes, decoded, last_flight
from gtmr_msgs_py import contract
from gtmr_msgs_py.contract import TopicName

_READ = (
    contract.ODOM,
    contract.ROTOR_STATES,
    contract.ROTOR_COMMAND,
    contract.TIGHTENING,
    contract.SOLVE_TIME,
    contract.CLEARANCE_RESIDUAL,
    contract.PREDICTED_PATH,
    contract.PARAMETER_EVENTS,
)


def read_recording(
    path: str | Path, odom: str | None = None, rotors: str | None = None
) -> Recording:
    """Read the flight of one vehicle, also of a bag from elsewhere.

    The topic of the odometry is needed if there are several and none is named ``odom``; that of
    the rotor speeds is ``rotor_states`` beside the odometry if left out. Raises BagError if the
    path is not a bag, holds no odometry that can be used, or not what is asked for.
    """
    bag = _Bag(Path(path))
    if odom is None:
        candidates = bag.ours or list(bag.of(contract.ODOM))
        if not candidates:
            raise BagError(f"{path}: holds no {contract.ODOM.type_name}: nothing to replay")
        if len(candidates) > 1:
            raise BagError(f"{path}: choose the odometry, --odom: {', '.join(candidates)}")
        odom = candidates[0]
        if not bag.ours:
            bag.notes.append(f"the odometry is that of {odom}")
    for topic, kind in ((odom, contract.ODOM), (rotors, contract.ROTOR_STATES)):
        if topic is not None and topic not in bag.of(kind):
            there = ", ".join(bag.of(kind)) or "none"
            raise BagError(
                f"{path}: holds no {kind.type_name} on {topic}; of that type there is {there}"
            )
    return bag.recording(odom, rotors)


def read_recordings(path: str | Path, vehicle: str | None = None) -> list[Recording]:
    """Read the flights of the vehicles in a bag, or of one, named as in `read_flights`.

    Raises BagError if the path is not a bag, or holds no odometry on a topic ``odom``, or not that
    vehicle's.
    """
    bag = _Bag(Path(path))
    if not bag.ours:
        raise BagError(f"{path}: not a flight: holds no odometry on a topic named odom")
    chosen = bag.ours
    if vehicle is not None:
        chosen = [t for t in bag.ours if _namespace(t).strip("/") == vehicle.strip("/")]
        if not chosen:
            names = ", ".join(_namespace(topic) or "/" for topic in bag.ours)
            raise BagError(f"{path}: holds no vehicle {vehicle!r}; allowed is {names}")
    return [bag.recording(topic) for topic in chosen]


class _Bag:
    """The messages that flights are made of, by type and topic, still serialised."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[str] = []
        self._by_type: dict[str, dict[str, list[BagMessage]]] = {t.type_name: {} for t in _READ}
        for message in read_messages(path):
            if message.msgtype in self._by_type:
                self._by_type[message.msgtype].setdefault(message.topic, []).append(message)
        self.ours = [name for name in self.of(contract.ODOM) if _is(contract.ODOM, name)]
        """Odometry of our vehicles, one topic each."""

    def of(self, topic: TopicName) -> dict[str, list[BagMessage]]:
        """Give all messages of a topic's type, by topic."""
        return dict(sorted(self._by_type[topic.type_name].items()))

    def recording(self, odom: str, rotors: str | None = None) -> Recording:
        namespace = _namespace(odom)
        rotors = rotors or self._beside(namespace, contract.ROTOR_STATES)
        # The odometry of a real vehicle seldom shares its controller's namespace.
        command = self._beside(namespace, contract.ROTOR_COMMAND)
        home = namespace if command is None else _namespace(command)
        notes = list(self.notes)
        late: dict[str, int] = {}

        def in_order(topic: TopicName, came: list[Recorded]) -> list[Recorded]:
            flown, _, n_late = last_flight(came)
            if n_late:
                late[topic.name] = n_late
                notes.append(
                    f"{n_late} of {len(flown)} {topic.name} messages came late: sorted in by "
                    "their stamps"
                )
            return flown

        def recorded(topic: TopicName, name: str | None = None) -> list[Recorded]:
            came = self.of(topic).get(name or f"{home}/{topic.name}", [])
            return decoded(message for message in came if message.log_time_ns >= begin_ns)

        measured = self._odometry(odom, notes)
        _, before_reset, _ = last_flight(measured)
        odometry = in_order(contract.ODOM, measured)
        begin_ns = min(item.received_ns for item in odometry)
        sent = recorded(contract.ROTOR_COMMAND)
        commands = in_order(contract.ROTOR_COMMAND, sent)
        stamped = {command.stamp_ns for command in commands}
        stem = self.path.resolve().stem
        return Recording(
            path=self.path,
            name=f"{stem}{namespace}" if len(self.ours) > 1 else stem,
            odom=odom,
            rotors=rotors,
            node=f"{home}/nmpc",
            odometry=odometry,
            before_reset=before_reset,
            rotor_states=in_order(contract.ROTOR_STATES, recorded(contract.ROTOR_STATES, rotors)),
            commands=commands,
            command_order=[s for s in dict.fromkeys(i.stamp_ns for i in sent) if s in stamped],
            tightening=recorded(contract.TIGHTENING),
            solve_times=recorded(contract.SOLVE_TIME),
            residuals=recorded(contract.CLEARANCE_RESIDUAL),
            predicted_paths=recorded(contract.PREDICTED_PATH),
            changes=changes(
                self.of(contract.PARAMETER_EVENTS).get(contract.PARAMETER_EVENTS.name, [])
            ),
            late=late,
            notes=tuple(notes),
            truncated=not is_whole(self.path),
        )

    def _odometry(self, topic: str, notes: list[str]) -> list[Recorded]:
        """Odometry whose pose is finite, as it came."""
        came = decoded(self.of(contract.ODOM)[topic])
        finite = [item for item in came if math.isfinite(_sum(item.message.pose.pose))]
        if not finite:
            raise BagError(f"{self.path}: holds no odometry on {topic} that can be used")
        if len(finite) < len(came):
            notes.append(f"{len(came) - len(finite)} odom messages are not finite: left out")
        frames = {(i.message.header.frame_id, i.message.child_frame_id): None for i in finite}
        notes += [
            f"frames {world!r} and {body!r} are taken as world ENU and body FLU"
            for world, body in frames
            if (world, body) != (contract.MAP, contract.BASE_LINK)
        ]
        return finite

    def _beside(self, namespace: str, topic: TopicName) -> str | None:
        """Find the topic in a namespace, or else the only one that is no other vehicle's."""
        named = [name for name in self.of(topic) if _is(topic, name)]
        if f"{namespace}/{topic.name}" in named:
            return f"{namespace}/{topic.name}"
        taken = set(map(_namespace, self.ours))
        free = [name for name in named if _namespace(name) not in taken]
        return free[0] if len(free) == 1 else None


def _is(topic: TopicName, name: str) -> bool:
    return name.rpartition("/")[2] == topic.name


def _namespace(name: str) -> str:
    return name.rpartition("/")[0]


def _sum(pose: Any) -> float:
    p, q = pose.position, pose.orientation
    return float(p.x + p.y + p.z + q.x + q.y + q.z + q.w)
