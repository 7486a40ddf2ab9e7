# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""What a flight was like: residual statistics, bags, reports; the node watches and records."""

from gtmr_monitor.bag import BagError
from gtmr_monitor.bag_flight import read_flight
from gtmr_monitor.bag_reader import BagMessage, TruncatedBagWarning, read_messages
from gtmr_monitor.bag_writer import BagWriter, OfferedQos
from gtmr_monitor.flight import Flight, Margins
from gtmr_monitor.residual import residual_statistics, solve_statistics

__all__ = [
    "BagError",
    "BagMessage",
    "BagWriter",
    "Flight",
    "Margins",
    "OfferedQos",
    "TruncatedBagWarning",
    "read_flight",
    "read_messages",
    "residual_statistics",
    "solve_statistics",
]
