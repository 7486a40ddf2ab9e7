# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Faults of real nodes in real processes, in real time."""

import signal
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gtmr_model import Tower, UncertaintySet
from gtmr_monitor.bag.flight import read_flights
from gtmr_msgs_py import topics
from gtmr_msgs_py.contract import Frames
from gtmr_msgs_py.messages import odometry, rotor_command, rotor_states
from gtmr_study.faults.fault import Fault, Outcome, Rng
from gtmr_study.faults.hostile import damaged
from gtmr_study.ros.faults.graph import Graph, GraphError
from gtmr_study.ros.faults.messages import PERIOD_NS

PLAN_NS = 20 * PERIOD_NS
"""How long a plan of the controller lasts [ns]."""
IN_CHARGE_NS = 50_000_000
"""By when after the plan's end the guard is to be in charge [ns]."""
WATCHED_NS = 3_000_000_000
"""How long a flight is watched after a fault [ns]."""
TOWER = Tower()


class Watch:
    """What a graph's flight does: the newest stamps, the least clearance, the guard."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.now_ns = -1
        self.x = np.zeros(18)
        self.plan_ns = -1
        """Stamp of the newest command [ns]."""
        self.guard = False
        self.guard_since_ns = -1
        self.least_m = np.inf
        graph.hear(topics.ODOM, self._on_odometry)
        graph.hear(topics.ROTOR_COMMAND, self._on_command)
        graph.hear(topics.GUARD, self._on_guard)

    def begin(self) -> None:
        """Forget what was least, and what was sent."""
        self._graph.sent.clear()
        self.least_m, self.guard_since_ns = np.inf, self.now_ns if self.guard else -1

    @property
    def flying(self) -> bool:
        """Whether plans are fresh, and the controller is in charge."""
        fresh = 0 <= self.now_ns - self.plan_ns < 2 * PERIOD_NS
        return self.plan_ns > 0 and fresh and not self.guard

    def _on_odometry(self, data: bytes) -> None:
        if self._graph.is_sent(data):
            return
        self.now_ns, self.x = odometry.unpack(data)
        self.least_m = min(self.least_m, float(TOWER.clearance(self.x[:3])))

    def _on_command(self, data: bytes) -> None:
        if self._graph.is_sent(data):
            return
        self.plan_ns = rotor_command.Reader(6).unpack(data).stamp_ns

    def _on_guard(self, data: bytes) -> None:
        guard = bool(data[4])
        if guard and not self.guard:
            self.guard_since_ns = self.now_ns
        self.guard = guard


@dataclass(frozen=True)
class InOneGraph:
    """Makes a ``run`` of what to start, and what to do once for each source of random numbers."""

    once: Callable[[Graph, Watch, Rng], Outcome]
    monitored: bool = False

    def __call__(self, rngs: Sequence[Rng]) -> Iterator[Outcome]:
        """Try once for each, in one flight after the other of the same graph."""
        with Graph() as graph:
            watch = Watch(graph)
            if self.monitored:
                graph.start("monitor", bag=graph.folder / "bag")
            graph.start("nmpc")
            graph.start("sim")
            graph.wait_until(lambda: watch.flying)
            for rng in rngs:
                try:
                    yield self._try(graph, watch, rng)
                except GraphError as error:
                    yield Outcome(False, _finite(watch.least_m), None, str(error))

    def _try(self, graph: Graph, watch: Watch, rng: Rng) -> Outcome:
        if "nmpc" not in graph.processes:
            graph.start("nmpc")
        graph.wait_until(lambda: watch.flying)
        zeta = UncertaintySet().sample(rng)
        graph.set("sim", zeta=zeta.tolist())
        _fly_on(graph, watch, int(1e9 * rng.uniform(1.0, 2.0)))
        watch.begin()
        outcome = self.once(graph, watch, rng)
        dead = graph.dead()
        if dead:
            return Outcome(False, outcome.clearance_m, None, f"{dead[0]} died")
        return outcome


def _wait_for_flight(graph: Graph, watch: Watch) -> None:
    graph.wait_until(lambda: watch.flying)


def _fly_on(graph: Graph, watch: Watch, duration_ns: int) -> None:
    end_ns = watch.now_ns + duration_ns
    graph.wait_until(lambda: watch.now_ns >= end_ns)


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _recovered(graph: Graph, watch: Watch, held: bool, why: str = "") -> Outcome:
    """Wait until the controller flies again, and judge."""
    start = time.monotonic()
    graph.wait_until(lambda: watch.flying)
    recovery_s = time.monotonic() - start
    if watch.least_m <= 0.0:
        return Outcome(False, watch.least_m, recovery_s, "came within 0 m")
    return Outcome(held, _finite(watch.least_m), recovery_s, why)


def nmpc_killed(graph: Graph, watch: Watch, rng: Rng) -> Outcome:
    """Kill the controller, watch the guard, start another controller."""
    graph.kill("nmpc")
    _fly_on(graph, watch, PLAN_NS + WATCHED_NS)
    late_ns = watch.guard_since_ns - (watch.plan_ns + PLAN_NS)
    in_charge = watch.guard_since_ns >= 0 and late_ns <= _patience_ns() + IN_CHARGE_NS
    graph.start("nmpc")
    return _recovered(graph, watch, in_charge, "the guard was late")


def nmpc_stopped(graph: Graph, watch: Watch, rng: Rng) -> Outcome:
    """Stop the controller's process for 0.2 to 3 s, and let it go on."""
    process = graph.processes["nmpc"]
    process.send_signal(signal.SIGSTOP)
    _fly_on(graph, watch, int(1e9 * rng.uniform(0.2, 3.0)))
    process.send_signal(signal.SIGCONT)
    return _recovered(graph, watch, True)


def damaged_messages(graph: Graph, watch: Watch, rng: Rng) -> Outcome:
    """Send 20 damaged messages beside the good ones, on every topic of the loop."""
    stamp_ns = max(watch.now_ns, 0)
    hover = np.full(6, 61.0)
    x = np.r_[watch.x[:12], hover]
    plan = np.tile(hover, (21, 1)), np.zeros((20, 6))
    good = (
        (topics.ODOM, odometry.pack(stamp_ns, x)),
        (topics.ROTOR_STATES, rotor_states.pack(stamp_ns, hover)),
        (topics.ROTOR_COMMAND, rotor_command.pack(stamp_ns, PERIOD_NS, *plan)),
    )
    for topic, data in good:
        for _ in range(20):
            graph.send(topic, damaged(data, rng))
    _fly_on(graph, watch, 500_000_000)
    return _recovered(graph, watch, True)


def foreign_odometry(graph: Graph, watch: Watch, rng: Rng) -> Outcome:
    """Send odometry of another frame, 2 m off: it is dropped and counted."""
    before = graph.drops("controller")
    x = np.r_[watch.x[:12], np.zeros(6)].copy()
    x[:3] += 2.0
    frames = Frames("odom_of_another", "base_link") if rng.random() < 0.5 else Frames("map", "arm")
    for _ in range(20):
        graph.send(topics.ODOM, odometry.pack(watch.now_ns, x, frames))
        graph.go_on(0.01)
    graph.wait_until(lambda: graph.drops("controller") > before)
    return _recovered(graph, watch, True)


def other_vehicle(graph: Graph, watch: Watch, rng: Rng) -> Outcome:
    """Send rotor speeds and commands of a vehicle of another number of rotors."""
    before = graph.drops("controller"), graph.drops("simulator")
    n = int(rng.choice([1, 4, 5, 7, 8]))
    hover = np.full(n, 61.0)
    for _ in range(20):
        plan = (np.tile(hover, (21, 1)), np.zeros((20, n)))
        graph.send(topics.ROTOR_STATES, rotor_states.pack(watch.now_ns, hover))
        graph.send(topics.ROTOR_COMMAND, rotor_command.pack(watch.now_ns, PERIOD_NS, *plan))
        graph.go_on(0.01)
    graph.wait_until(
        lambda: graph.drops("controller") > before[0] and graph.drops("simulator") > before[1]
    )
    return _recovered(graph, watch, True)


def sim_killed(graph: Graph, watch: Watch, rng: Rng) -> Outcome:
    """Kill the simulator and start another: the flight begins again under the same controller."""
    graph.kill("sim")
    watch.now_ns = watch.plan_ns = -1
    graph.start("sim")
    graph.wait_until(lambda: watch.now_ns > 0)
    return _recovered(graph, watch, True)


def monitor_killed(graph: Graph, watch: Watch, rng: Rng) -> Outcome:
    """Kill the recorder and start it again with the same bag: what is missing is said."""
    bag = graph.folder / "bag"
    graph.kill("monitor")
    graph.start("monitor", bag=bag)
    graph.wait_until(lambda: "monitor" in "".join(graph.node.get_node_names()))
    _fly_on(graph, watch, 2_000_000_000)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        flight = read_flights(bag)[-1]
    lost_s = flight.coverage.expected_s - flight.coverage.covered_s
    held = not flight.coverage.whole and lost_s < flight.coverage.expected_s
    return _recovered(graph, watch, held, "the gap is not told")


def _patience_ns() -> int:
    from gtmr_guard import GuardConfig

    return round(1e9 * GuardConfig().patience_s)


def sockets(rngs: Sequence[Rng]) -> Iterator[Outcome]:
    """Start the three nodes, and look for a socket that listens beyond this machine."""
    for _ in rngs:
        with Graph() as graph:
            watch = Watch(graph)
            graph.start("monitor", bag=graph.folder / "bag")
            graph.start("nmpc")
            graph.start("sim")
            _wait_for_flight(graph, watch)
            found = {address for p in graph.processes.values() for address in listening(p.pid)}
        yield Outcome(not found, why=f"listens on {', '.join(sorted(found))}")


def listening(pid: int) -> set[str]:
    """Addresses beyond this machine on which a process listens, as the kernel has them."""
    inodes = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = str(link.readlink())
        except OSError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = set()
    groups = _groups_beyond_loopback(Path(f"/proc/{pid}/net/igmp").read_text(encoding="utf-8"))
    for table in ("tcp", "udp", "tcp6", "udp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text(encoding="utf-8").splitlines()[1:]:
            fields = line.split()
            address, remote = fields[1].partition(":")[0], fields[2].partition(":")[0]
            local = address.endswith("7F") and len(address) == 8
            local = local or address in ("0100007F", "00000000000000000000000001000000")
            # A group that is joined on the loopback alone is heard of nobody else.
            local = local or (address[-2:] == "EF" and address not in groups)
            if fields[9] in inodes and not local and set(remote) == {"0"}:
                found.add(f"{table} {fields[1]}")
    return found


def _groups_beyond_loopback(igmp: str) -> set[str]:
    """Multicast groups that another interface than the loopback has joined, as hexadecimal."""
    device, groups = "", set()
    for line in igmp.splitlines()[1:]:
        fields = line.split()
        if fields[0].isdigit():
            device = fields[1]
        elif device != "lo":
            groups.add(fields[0])
    return groups


CLEAR = "stays clear of the tower; no node dies; the controller flies again"


def faults() -> list[Fault]:
    """Give the faults between real nodes."""
    return [
        Fault(
            "node-nmpc-killed",
            "stays clear of the tower, with the guard in charge within 50 ms of its patience past "
            "the plan's end; another controller takes over",
            "nodes", 100, 1, InOneGraph(nmpc_killed),
        ),
        Fault("node-nmpc-stopped", CLEAR, "nodes", 30, 1, InOneGraph(nmpc_stopped)),
        Fault("node-messages-damaged", CLEAR, "nodes", 30, 1, InOneGraph(damaged_messages, True)),
        Fault(
            "node-odometry-foreign", f"is dropped and counted; {CLEAR}", "nodes", 20, 1,
            InOneGraph(foreign_odometry),
        ),
        Fault(
            "node-other-vehicle", f"is dropped and counted; {CLEAR}", "nodes", 20, 1,
            InOneGraph(other_vehicle),
        ),
        Fault("node-sim-killed", CLEAR, "nodes", 10, 1, InOneGraph(sim_killed)),
        Fault(
            "node-monitor-killed", "goes on in the same bag, and the gap is told", "nodes", 10, 1,
            InOneGraph(monitor_killed, True),
        ),
        Fault("node-sockets", "no node listens beyond this machine", "nodes", 1, 1, sockets),
    ]  # fmt: skip
