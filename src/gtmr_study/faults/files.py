# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Faults on files: damaged bags, hostile configurations, paths that lead nowhere."""

import atexit
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from gtmr_model import ConfigError
from gtmr_monitor.bag.flight import read_flights
from gtmr_monitor.bag.format import BagError, typestore
from gtmr_monitor.bag.reader import read_messages
from gtmr_monitor.bag.writer import BagWriter
from gtmr_nmpc import ControllerConfig
from gtmr_sim import Scenario
from gtmr_study.faults.fault import Fault, OneByOne, Outcome, Rng
from gtmr_study.faults.hostile import path_name, yaml_text
from gtmr_study.result_files import (
    InputError,
    require_empty_folder,
    require_folder_of,
    require_new_file,
    write_json,
)

ODOMETRY = "nav_msgs/msg/Odometry"
PERIOD_NS = 25_000_000
"""Of the odometry in the bag that is damaged [ns]."""
SAMPLES = 200
"""How many it has: 5 s."""
LONGEST_LOAD_S = 2.0
"""How long a configuration may take to be read or refused, processor time [s]."""

Change = Callable[[Path, Rng], None]


@lru_cache(maxsize=1)
def _folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="gtmr_faults_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@lru_cache(maxsize=1)
def good_bag() -> tuple[Path, Any]:
    """Write a bag of 5 s, once a process; gives it, and its clearances [m] by time [s]."""
    folder = _folder() / "good"
    with BagWriter(folder, flush_period_s=0.0) as bag:
        bag.add_topic("/odom", ODOMETRY)
        for k in range(SAMPLES):
            bag.write("/odom", odometry(k), 10**18 + k * PERIOD_NS)
    (flight,) = read_flights(folder)
    return folder, dict(zip(flight.t.round(6).tolist(), flight.clearance.tolist(), strict=True))


def odometry(k: int) -> bytes:
    """Make the k-th odometry as CDR: at rest and level, the clearance another each time."""
    store = typestore()

    def new(name: str, *fields: Any) -> Any:
        return store.types[name](*fields)

    zero = new("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    point = new("geometry_msgs/msg/Point", 1.3 + 0.001 * k, 0.0, 2.0)
    upright = new("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    pose = new("geometry_msgs/msg/Pose", point, upright)
    twist = new("geometry_msgs/msg/Twist", zero, zero)
    stamp = new("builtin_interfaces/msg/Time", *divmod(k * PERIOD_NS, 10**9))
    message = new(
        ODOMETRY,
        new("std_msgs/msg/Header", stamp, "map"),
        "base_link",
        new("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
        new("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
    )
    return bytes(store.serialize_cdr(message, ODOMETRY))


def flip(bag: Path, rng: Rng) -> None:
    """Flip one bit of the record."""
    file, raw = _record(bag)
    raw[rng.integers(len(raw))] ^= 1 << int(rng.integers(8))
    file.write_bytes(raw)


def blank(bag: Path, rng: Rng) -> None:
    """Blank 1 to 4096 bytes, as a bad sector does."""
    file, raw = _record(bag)
    at, length = int(rng.integers(len(raw))), int(rng.integers(1, 4097))
    raw[at : at + length] = bytes(len(raw[at : at + length]))
    file.write_bytes(raw)


def cut(bag: Path, rng: Rng) -> None:
    """Cut the record short anywhere, its end and metadata lost, as by a killed writer."""
    file, raw = _record(bag)
    file.write_bytes(raw[: rng.integers(len(raw))])
    (bag / "metadata.yaml").unlink()


def swap(bag: Path, rng: Rng) -> None:
    """Exchange two odometries."""
    a, b = sorted(rng.choice(SAMPLES, 2, replace=False).tolist())

    def exchanged(data: list[bytes]) -> None:
        data[a], data[b] = data[b], data[a]

    _rewrite(bag, exchanged)


def spoil(bag: Path, rng: Rng) -> None:
    """Make one odometry undecodable."""

    def spoilt(data: list[bytes]) -> None:
        k = int(rng.integers(SAMPLES))
        data[k] = data[k][: rng.integers(len(data[k]) - 8)]

    _rewrite(bag, spoilt)


def _record(bag: Path) -> tuple[Path, bytearray]:
    (file,) = bag.glob("*.mcap")
    return file, bytearray(file.read_bytes())


def _rewrite(bag: Path, change: Callable[[list[bytes]], None]) -> None:
    messages = list(read_messages(bag))
    data = [message.data for message in messages]
    change(data)
    shutil.rmtree(bag)
    with BagWriter(bag) as copy:
        copy.add_topic("/odom", ODOMETRY)
        for message, each in zip(messages, data, strict=True):
            copy.write("/odom", each, message.log_time_ns, message.publish_time_ns)


def read_damaged(change: Change, rng: Rng) -> Outcome:
    """Damage a copy of a bag, and see that what is read was written, and what is missing said."""
    good, written = good_bag()
    with tempfile.TemporaryDirectory(dir=_folder()) as folder:
        bag = Path(folder) / "bag"
        shutil.copytree(good, bag)
        change(bag, rng)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                flights = read_flights(bag)
        except BagError as error:
            return Outcome("\n" not in str(error), why="refused in several lines")
        except Exception as error:
            return Outcome(False, why=f"{type(error).__name__} instead of what is left")
    (flight,) = flights
    clearances = set(written.values())
    if not set(flight.clearance.tolist()) <= clearances:
        return Outcome(False, why="read what was not written")
    said = not flight.coverage.whole or flight.late or flight.notes
    if len(flight.t) < len(written) and not said:
        return Outcome(False, why="less than all without a word")
    return Outcome(True)


def load_hostile(rng: Rng) -> Outcome:
    """Load YAML as a configuration: it is taken, or refused in one line, at once."""
    kind = (ControllerConfig, Scenario)[int(rng.integers(2))]
    file = _folder() / "hostile.yaml"
    file.write_bytes(yaml_text(_template(), rng))
    start = time.thread_time()
    try:
        kind.from_yaml(file)
    except ConfigError as error:
        if "\n" in str(error):
            return Outcome(False, why="refused in several lines")
    except Exception as error:
        return Outcome(False, why=type(error).__name__)
    took_s = time.thread_time() - start
    return Outcome(took_s < LONGEST_LOAD_S, why="took too long")


@lru_cache(maxsize=1)
def _template() -> str:
    return "horizon: 20\nsampling_time_s: 0.025\ntower: {radius_m: 1.0}\nvehicle: paper\n"


def write_to(rng: Rng) -> Outcome:
    """Write a result to a path that hardly is one: it is written whole, or refused in one line."""
    name = path_name(rng)
    try:
        path = Path(name) if name.startswith("/") else _folder() / name
        require_new_file("--out", path)
        require_folder_of("--json", path)
        require_empty_folder("--out", path)
        write_json(path, {"a": 1})
        path.unlink(missing_ok=True)
    except (InputError, OSError) as error:
        # The command line tells both. A line end in a name is the user's own.
        return Outcome("\n" not in str(error).replace(name, ""), why="refused in several lines")
    except Exception as error:
        return Outcome(False, why=type(error).__name__)
    return Outcome(True)


BAG = "what is read was written, and what is missing is said"
LINE = "is taken, or refused in one line, within 2 s"


def faults() -> list[Fault]:
    """Give the faults on files."""
    bags: dict[str, Change] = {
        "bag-bit-flipped": flip,
        "bag-block-blanked": blank,
        "bag-cut": cut,
        "bag-odometries-swapped": swap,
        "bag-odometry-undecodable": spoil,
    }
    made = [
        Fault(name, BAG, "files", 300, 6, OneByOne(partial(read_damaged, change)))
        for name, change in bags.items()
    ]
    return [
        *made,
        Fault("yaml-hostile", LINE, "files", 4000, 100, OneByOne(load_hostile)),
        Fault(
            "paths-hostile",
            "is written whole, or refused in one line",
            "files",
            1000,
            100,
            OneByOne(write_to),
        ),
    ]
