# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Faults on the way between simulator and controller: of measurements, and of commands."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gtmr_model.dynamics import POSITION
from gtmr_sim.session import NANOSECONDS
from gtmr_study.faults.loop import Disturbance, DisturbedFlight, Link, Measurement, Sent

Range = tuple[float, float]
CLEAR = "stays clear of the tower, and is back at its reference within 6 s of the end"
KEEPS = "keeps d_min = 0.2 m, and is back at its reference within 6 s of the end"
COUNTED = "none is given: it is counted how often the vehicle stays clear of the tower"
D_MIN_M = 0.2
"""What the robust controller keeps [m] (Table I)."""


def lost(share: float) -> Link:
    """Lose a share of the messages."""
    return lambda flight, message: [] if flight.rng.random() < share else [(0.0, message)]


def late(delay_s: Range) -> Link:
    """Hold all messages back by a delay of this flight, from a range [s]."""

    def link(flight: DisturbedFlight, message: Any) -> Sent:
        return [(flight.once("delay", lambda: float(flight.rng.uniform(*delay_s))), message)]

    return link


def uneven(delay_s: Range) -> Link:
    """Hold each message back by a delay of its own [s]: they overtake each other."""
    return lambda flight, message: [(float(flight.rng.uniform(*delay_s)), message)]


def twice(flight: DisturbedFlight, message: Any) -> Sent:
    """Carry a message twice, the second time up to 50 ms later."""
    return [(0.0, message), (float(flight.rng.uniform(0.0, 0.05)), message)]


def stuck(flight: DisturbedFlight, message: Any) -> Sent:
    """Carry the first message again and again."""
    return [(0.0, flight.once("first", lambda: message))]


def bad_network(flight: DisturbedFlight, message: Any) -> Sent:
    """Lose a fifth, double a fifth, and hold each back by up to 20 ms."""
    copies = flight.rng.choice([0, 1, 2], p=[0.2, 0.6, 0.2])
    return [(float(flight.rng.uniform(0.0, 0.02)), message) for _ in range(copies)]


def changed(share: float, change: Callable[[DisturbedFlight, Any], Any]) -> Link:
    """Change a share of the messages."""

    def link(flight: DisturbedFlight, message: Any) -> Sent:
        return [(0.0, change(flight, message) if flight.rng.random() < share else message)]

    return link


def frozen(flight: DisturbedFlight, m: Measurement) -> Measurement:
    """Keep the state of the first under new stamps."""
    return replace(m, x=flight.once("first", lambda: m.x))


def not_finite(flight: DisturbedFlight, message: Any) -> Any:
    """Put a number that is none among the others."""
    name = "x" if isinstance(message, Measurement) else "u_plan"
    values = getattr(message, name).copy()
    values.flat[flight.rng.integers(values.size)] = flight.rng.choice([np.nan, np.inf, -np.inf])
    return replace(message, **{name: values})


def jumped(flight: DisturbedFlight, m: Measurement) -> Measurement:
    """Move the position by 0.5 to 10 m, to anywhere."""
    return _moved(m, flight.rng.uniform(0.5, 10.0) * _direction(flight))


def stepped(flight: DisturbedFlight, m: Measurement) -> Measurement:
    """Move the position by 0.1 m, in one direction of this flight."""
    return _moved(m, flight.once("step", lambda: 0.1 * _direction(flight)))


def drifting(flight: DisturbedFlight, m: Measurement) -> Measurement:
    """Move the position by 0.05 m for each second, in one direction of this flight."""
    along = flight.once("direction", lambda: _direction(flight))
    return _moved(m, 0.05 * (flight.time_s - flight.starts_s) * along)


def _direction(flight: DisturbedFlight) -> Any:
    direction = flight.rng.standard_normal(3)
    return direction / np.linalg.norm(direction)


def _moved(m: Measurement, by_m: Any) -> Measurement:
    x = m.x.copy()
    x[POSITION] += by_m
    return replace(m, x=x)


def stamped(offset_s: Range) -> Callable[[DisturbedFlight, Any], Any]:
    """Put a stamp off by a time from a range [s]."""

    def change(flight: DisturbedFlight, message: Any) -> Any:
        off_ns = round(NANOSECONDS * flight.rng.uniform(*offset_s))
        return replace(message, stamp_ns=max(0, message.stamp_ns + off_ns))

    return change


def scaled(flight: DisturbedFlight, message: Any) -> Any:
    """Command far more than the rotors can do."""
    factor = flight.rng.uniform(10.0, 1e6) * flight.rng.choice([-1.0, 1.0])
    return replace(message, u_plan=factor * message.u_plan)


MEASUREMENTS: dict[str, tuple[str, Disturbance]] = {
    "odometry-lost-50": (KEEPS, Disturbance(measured=lost(0.5), least_m=D_MIN_M)),
    "odometry-gap": (CLEAR, Disturbance((0.2, 3.0), measured=lost(1.0))),
    "odometry-late-25": (KEEPS, Disturbance(measured=late((0.02, 0.03)), least_m=D_MIN_M)),
    "odometry-late-50": (CLEAR, Disturbance(measured=late((0.045, 0.055)))),
    "odometry-late-75": (CLEAR, Disturbance(measured=late((0.07, 0.08)))),
    "odometry-late-100": (CLEAR, Disturbance(measured=late((0.095, 0.105)))),
    "odometry-uneven": (CLEAR, Disturbance(measured=uneven((0.0, 0.04)))),
    "odometry-twice": (KEEPS, Disturbance(measured=twice, least_m=D_MIN_M)),
    "odometry-stuck": (CLEAR, Disturbance((0.2, 3.0), measured=stuck)),
    "odometry-frozen": (COUNTED, Disturbance((0.1, 1.0), measured=changed(1.0, frozen))),
    "odometry-nan": (KEEPS, Disturbance(measured=changed(0.5, not_finite), least_m=D_MIN_M)),
    "odometry-jump": (KEEPS, Disturbance(measured=changed(0.1, jumped), least_m=D_MIN_M)),
    "odometry-step": (CLEAR, Disturbance(measured=changed(1.0, stepped))),
    "odometry-drift": (CLEAR, Disturbance(measured=changed(1.0, drifting))),
    "odometry-from-future": (
        KEEPS,
        Disturbance(measured=changed(0.1, stamped((0.1, 100.0))), least_m=D_MIN_M),
    ),
    "odometry-from-past": (
        KEEPS,
        Disturbance(measured=changed(0.1, stamped((-100.0, -0.01))), least_m=D_MIN_M),
    ),
}
"""By name: what is promised, and the disturbance."""

COMMANDS: dict[str, tuple[str, Disturbance]] = {
    "commands-lost-10": (KEEPS, Disturbance(commanded=lost(0.1), least_m=D_MIN_M)),
    "commands-lost-30": (KEEPS, Disturbance(commanded=lost(0.3), least_m=D_MIN_M)),
    "commands-lost-50": (KEEPS, Disturbance(commanded=lost(0.5), least_m=D_MIN_M)),
    "commands-gap-0.6": (CLEAR, Disturbance((0.6, 0.6), commanded=lost(1.0))),
    "commands-gap-0.75": (CLEAR, Disturbance((0.75, 0.75), commanded=lost(1.0))),
    "commands-gap-1": (CLEAR, Disturbance((1.0, 1.0), commanded=lost(1.0))),
    "commands-gap-3": (CLEAR, Disturbance((1.0, 3.0), commanded=lost(1.0))),
    "commands-late": (CLEAR, Disturbance(commanded=late((0.005, 0.1)))),
    "commands-uneven": (CLEAR, Disturbance(commanded=uneven((0.0, 0.1)))),
    "commands-twice": (KEEPS, Disturbance(commanded=twice, least_m=D_MIN_M)),
    "commands-nan": (CLEAR, Disturbance(commanded=changed(0.5, not_finite))),
    "commands-beyond-limits": (CLEAR, Disturbance(commanded=changed(0.1, scaled))),
    "commands-from-future": (
        KEEPS,
        Disturbance(commanded=changed(0.3, stamped((0.01, 100.0))), least_m=D_MIN_M),
    ),
    "commands-from-past": (
        KEEPS,
        Disturbance(commanded=changed(0.3, stamped((-100.0, -0.03))), least_m=D_MIN_M),
    ),
    "bad-network": (CLEAR, Disturbance(measured=bad_network, commanded=bad_network)),
}
"""By name: what is promised, and the disturbance."""
