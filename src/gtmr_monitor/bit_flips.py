# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Flips single bits of a bag, and looks whether the reader says what it lost.

A reader of damaged bags is only as good as this: for any bit, the flight is the same as that of
the whole bag, or its coverage says what is missing.
"""

import random
import shutil
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gtmr_monitor.bag.flight import read_flight
from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.losses import Losses
from gtmr_monitor.bag.reader import DamagedBagWarning, read_messages
from gtmr_monitor.flight import Flight


@dataclass
class FlipResult:
    """What became of the flips."""

    tried: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    """How many gave the ``same`` flight, one that is ``told`` not to be whole, or a ``refusal`` to
    read the bag at all."""
    silent: list[str] = field(default_factory=list)
    """Where a shortfall was not told, or told wrong: file, byte and bit; must stay empty."""


def flip_bits(
    bag: str | Path, tries: int, seed: int, on_try: Callable[[int], object] = lambda _: None
) -> FlipResult:
    """Flip one random bit of a copy of a bag, of its MCAP files or metadata.yaml, so many times.

    The bag holds one vehicle, and is whole; a small one is quickest. ``on_try`` is told how many
    tries are done. Raises BagError if the bag itself cannot be read.
    """
    draw, result = random.Random(seed), FlipResult()
    flown, messages = _read(Path(bag))
    with tempfile.TemporaryDirectory(prefix="gtmr_flips_") as scratch:
        copy = Path(scratch) / Path(bag).name
        shutil.copytree(bag, copy)
        files = sorted(copy.iterdir())
        sizes = [file.stat().st_size for file in files]
        for k in range(tries):
            (file,) = draw.choices(files, sizes)
            whole = file.read_bytes()
            at, bit = draw.randrange(len(whole)), draw.randrange(8)
            flipped = bytearray(whole)
            flipped[at] ^= 1 << bit
            file.write_bytes(flipped)
            outcome = _outcome(copy, flown, messages)
            result.tried += 1
            result.outcomes[outcome] += 1
            if outcome not in ("same", "told"):
                result.silent.append(f"{file.name}, byte {at}, bit {bit}: {outcome}")
            file.write_bytes(whole)
            on_try(k + 1)
    return result


def _outcome(bag: Path, flown: Flight, messages: int) -> str:
    try:
        flight, left = _read(bag)
    except BagError:
        return "refusal"
    lost = sum(flight.coverage.lost_messages.values())
    same = (
        np.array_equal(flight.t, flown.t)
        and np.array_equal(flight.p, flown.p)
        and np.array_equal(flight.recorded_residual, flown.recorded_residual)
        and np.array_equal(flight.rotor_speed_hz, flown.rotor_speed_hz)
        and np.array_equal(flight.margins.total, flown.margins.total)
        and np.array_equal(flight.solve_ms, flown.solve_ms)
        and flight.parameters == flown.parameters
        and left == messages
    )
    if same:
        return "same"
    if flight.coverage.whole:
        return "silent"
    if lost != messages - left:
        return f"{messages - left} messages are missing, told are {lost}"
    # Lost time is lost odometry, to within one period at either end.
    if abs(flight.coverage.expected_s - flown.coverage.expected_s) > 0.051:
        return f"told are {flight.coverage}, not {flown.coverage.expected_s:g} s"
    return "told"


def _read(bag: Path) -> tuple[Flight, int]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DamagedBagWarning)
        return read_flight(bag), sum(1 for _ in read_messages(bag, Losses()))
