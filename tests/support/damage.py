# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A small whole bag of one flight, and ways to damage it."""

import numpy as np

from gtmr_monitor.bag.writer import BagWriter
from support.written_bags import FLOAT64, ODOMETRY, cdr, new, odometry

PERIOD_S = 0.025
SAMPLES = 401
PER_CHUNK = 40
TOO_CLOSE = 100
"""Which sample is 0.1 m from the tower; all others are clear."""


def clearance_m(k):
    return 0.1 if k == TOO_CLOSE else 0.35


def small_bag(folder, samples=SAMPLES, start=0):
    """10 s of odometry and residuals, in chunks of a second."""
    with BagWriter(folder) as bag:
        bag.add_topic("/odom", ODOMETRY)
        bag.add_topic("/clearance_residual", FLOAT64)
        bag.add_topic("/solve_time", FLOAT64)
        for k in range(start, start + samples):
            stamp_ns, at_ns = k * 25_000_000, 10**18 + k * 25_000_000
            angle = 0.01 * k
            distance = 1.0 + clearance_m(k)
            p = (distance * np.cos(angle), distance * np.sin(angle), 2.0 + 0.001 * k)
            bag.write("/odom", cdr(odometry(stamp_ns, p)), at_ns)
            bag.write("/clearance_residual", cdr(new(FLOAT64, 0.2 - clearance_m(k))), at_ns)
            bag.write("/solve_time", cdr(new(FLOAT64, 0.001)), at_ns)
            if k % PER_CHUNK == PER_CHUNK - 1:
                bag.flush()
    return folder


def file_of(bag):
    (path,) = bag.glob("*.mcap")
    return path


def chunk_offsets(path):
    """Where the chunks of a whole file begin, and how long they are [bytes]."""
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    return sorted((c.chunk_start_offset, c.chunk_length) for c in chunks)


def flip(path, at, bit=0):
    data = bytearray(path.read_bytes())
    data[at] ^= 1 << bit
    path.write_bytes(data)


def damage_chunks(bag, *numbers):
    """Flip a bit in the middle of chunks, counted from 0; negative from the end."""
    offsets = chunk_offsets(file_of(bag))
    for number in numbers:
        begin, length = offsets[number]
        flip(file_of(bag), begin + length // 2)
    return bag
