# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Margins that tighten the clearance constraint: one a file, chosen by name."""

from gtmr_nmpc.margins.closed_loop import ClosedLoopMargin, Deviations
from gtmr_nmpc.margins.fixed import FixedMargin
from gtmr_nmpc.margins.margin import Iterate, Margin, Tightening
from gtmr_nmpc.margins.paper import PaperMargin
from gtmr_nmpc.margins.second_order import SecondOrderMargin

__all__ = [
    "ClosedLoopMargin",
    "Deviations",
    "FixedMargin",
    "Iterate",
    "Margin",
    "PaperMargin",
    "SecondOrderMargin",
    "Tightening",
]
