# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Finding the flights of a bag: which vehicles it holds, and which topics are whose."""

import math
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.losses import Losses
from gtmr_monitor.bag.reader import BagMessage, read_messages
from gtmr_monitor.bag.recording import (
    Change,
    Recorded,
    Recording,
    changes,
    decoded,
    last_flight,
    without_strays,
)
from gtmr_monitor.coverage import Coverage, gaps_between, period_of
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
    contract.GUARD,
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
        self._losses = Losses()
        self._by_type: dict[str, dict[str, list[BagMessage]]] = {t.type_name: {} for t in _READ}
        for message in read_messages(path, self._losses):
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
        notes, dropped, late = list(self.notes), Counter[str](), dict[str, int]()

        def in_order(topic: TopicName, came: list[Recorded]) -> tuple[list[Recorded], ...]:
            """Sort the last flight; what came before it is returned too."""
            there = without_strays(came)
            if len(there) < len(came):
                dropped[f"misdated {topic.name}"] = len(came) - len(there)
            flown, before, n_late = last_flight(there)
            if n_late:
                late[topic.name] = n_late
                notes.append(
                    f"{n_late} of {len(flown)} {topic.name} messages came late: sorted in by "
                    "their stamps"
                )
            return flown, before

        def recorded(topic: TopicName, name: str | None = None) -> list[Recorded]:
            came = self.of(topic).get(name or f"{home}/{topic.name}", [])
            return decoded((m for m in came if m.log_time_ns >= begin_ns), dropped)

        odometry, before_reset = in_order(contract.ODOM, self._odometry(odom, notes, dropped))
        begin_ns = min(item.received_ns for item in odometry)
        truth = self._truth(f"{namespace}/{contract.GROUND_TRUTH.name}", dropped)
        ground_truth, before_truth = in_order(contract.GROUND_TRUTH, truth)
        sent = recorded(contract.ROTOR_COMMAND)
        commands, _ = in_order(contract.ROTOR_COMMAND, sent)
        stamped = {command.stamp_ns for command in commands}
        rotor_states, _ = in_order(contract.ROTOR_STATES, recorded(contract.ROTOR_STATES, rotors))
        tightening = recorded(contract.TIGHTENING)
        solve_times = recorded(contract.SOLVE_TIME)
        residuals = recorded(contract.CLEARANCE_RESIDUAL)
        predicted_paths = recorded(contract.PREDICTED_PATH)
        guard = recorded(contract.GUARD)
        told = changes(
            self.of(contract.PARAMETER_EVENTS).get(contract.PARAMETER_EVENTS.name, []), dropped
        )
        notes += [f"{n} {cause} left out" for cause, n in dropped.items()]
        stem = self.path.resolve().stem
        return Recording(
            path=self.path,
            name=f"{stem}{namespace}" if len(self.ours) > 1 else stem,
            odom=odom,
            rotors=rotors,
            node=f"{home}/nmpc",
            odometry=odometry,
            ground_truth=ground_truth,
            before_reset=before_truth or before_reset,
            rotor_states=rotor_states,
            commands=commands,
            command_order=[s for s in dict.fromkeys(i.stamp_ns for i in sent) if s in stamped],
            tightening=tightening,
            solve_times=solve_times,
            residuals=residuals,
            predicted_paths=predicted_paths,
            guard=guard,
            changes=told,
            late=late,
            notes=tuple(notes),
            truncated=not self._losses.has_end,
            coverage=self._coverage(
                odom, odometry, bool(before_reset), dropped, _told_period_s(told, home)
            ),
        )

    def _coverage(
        self,
        odom: str,
        flown: list[Recorded],
        was_reset: bool,
        dropped: Counter[str],
        told_period_s: float | None,
    ) -> Coverage:
        """Find the gaps of a flight, and whether the bag lost what is not there."""
        losses, lost = self._losses, self._losses.topics[odom]
        causes = losses.causes + dropped
        stamps_ns = [item.stamp_ns for item in flown]
        t = (np.array(stamps_ns, dtype=np.int64) - stamps_ns[0]) * 1e-9
        period_s = period_of(np.array(stamps_ns), told_period_s)
        begin = gaps_between(stamps_ns, period_s)
        gaps = [(float(t[k]), float(t[k + 1])) for k in begin]
        places = [message.place for message in self.of(contract.ODOM)[odom]]
        numbered = not losses.recovered and all(a < b for a, b in pairwise(places))
        there = {item.place for item in flown}
        for k in begin:
            (file, a), (other_file, b) = sorted((flown[k].place, flown[k + 1].place))
            if file != other_file:
                if not losses:
                    causes["recorder stopped"] += 1
            elif all((file, n) in there for n in range(a + 1, b)) if numbered else not losses:
                causes["not heard"] += 1
        # What waits repeats itself: lost in front is no more time than since time zero.
        head_s = 0.0 if was_reset else min(lost.head * period_s, stamps_ns[0] * 1e-9)
        tail = lost.tail
        if not numbered and period_s:
            tail += max(0, lost.inside - sum(round((b - a) / period_s) - 1 for a, b in gaps))
        tail_s = tail * period_s
        if head_s:
            gaps.insert(0, (-head_s, 0.0))
        if tail_s:
            gaps.append((float(t[-1]), float(t[-1]) + tail_s))
        expected_s = head_s + float(t[-1]) + tail_s
        others = set(map(_namespace, self.ours)) - {_namespace(odom)}
        return Coverage(
            covered_s=expected_s - sum(end - begin for begin, end in gaps),
            expected_s=expected_s,
            gaps=tuple(gaps),
            causes=dict(causes),
            lost_messages={
                topic: n for topic, n in losses.messages.items() if _namespace(topic) not in others
            },
        )

    def _truth(self, topic: str, dropped: Counter[str]) -> list[Recorded]:
        """Read true states whose pose is finite, as they came."""
        came = decoded(self.of(contract.GROUND_TRUTH).get(topic, []), dropped)
        return [item for item in came if math.isfinite(_sum(item.message.pose.pose))]

    def _odometry(self, topic: str, notes: list[str], dropped: Counter[str]) -> list[Recorded]:
        """Odometry whose pose is finite, as it came."""
        came = decoded(self.of(contract.ODOM)[topic], dropped)
        finite = [item for item in came if math.isfinite(_sum(item.message.pose.pose))]
        if not finite:
            raise BagError(f"{self.path}: holds no odometry on {topic} that can be used")
        if len(finite) < len(came):
            dropped["not finite odom"] = len(came) - len(finite)
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


def _told_period_s(told: list[Change], home: str) -> float | None:
    """Period of the simulator's odometry [s], by its parameters; None if they are not there."""
    values: dict[str, Any] = {}
    for change in told:
        if change.node == f"{home}/sim":
            values |= change.values
    period_s = values.get("sampling_time_s")
    if not values.get("lockstep") and (rate_hz := values.get("odometry_rate_hz")):
        period_s = 1.0 / rate_hz
    return period_s if isinstance(period_s, float) else None


def _is(topic: TopicName, name: str) -> bool:
    return name.rpartition("/")[2] == topic.name


def _namespace(name: str) -> str:
    return name.rpartition("/")[0]


def _sum(pose: Any) -> float:
    p, q = pose.position, pose.orientation
    return float(p.x + p.y + p.z + q.x + q.y + q.z + q.w)
