# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a flight was like: residual statistics, bags, reports; the node watches and records."""

from gtmr_monitor.bag.flight import read_flight, read_flights
from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.metadata import OfferedQos
from gtmr_monitor.bag.reader import (
    BagMessage,
    DamagedBagWarning,
    TruncatedBagWarning,
    read_messages,
)
from gtmr_monitor.bag.writer import BagWriter
from gtmr_monitor.coverage import Coverage
from gtmr_monitor.flight import Flight, MarginHistory
from gtmr_monitor.residual import residual_statistics, solve_statistics

__all__ = [
    "BagError",
    "BagMessage",
    "BagWriter",
    "Coverage",
    "DamagedBagWarning",
    "Flight",
    "MarginHistory",
    "OfferedQos",
    "TruncatedBagWarning",
    "read_flight",
    "read_flights",
    "read_messages",
    "residual_statistics",
    "solve_statistics",
]
