# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The margins of a controller step, stage by stage, as std_msgs/Float64MultiArray."""

from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from gtmr_model.uncertainty import N_ZETA
from gtmr_msgs_py.contract import TIGHTENING_COLUMNS as COLUMNS
from gtmr_msgs_py.contract import TIGHTENING_STAGE as STAGE
from gtmr_msgs_py.wire.message_error import MessageError


@dataclass(frozen=True)
class PublishedTightening:
    """The margins of a controller step."""

    by_channel: NDArray[np.float64]
    """Terms of alpha_p without eps_s [m], shape (N + 1, 9)."""
    eps_s: NDArray[np.float64]
    """The constant term of alpha_p [m], shape (N + 1,)."""
    alpha_g: NDArray[np.float64]
    """Gust margin [m], shape (N + 1,)."""
    slack: NDArray[np.float64]
    """Violation of the tightened clearance [m], shape (N + 1,)."""

    @property
    def alpha_p(self) -> NDArray[np.float64]:
        """Parametric margin, eq. (12), eps_s included [m], shape (N + 1,)."""
        total: NDArray[np.float64] = self.by_channel.sum(axis=1) + self.eps_s
        return total


def encode(
    by_channel: ArrayLike, eps_s: ArrayLike, alpha_g: ArrayLike, slack: ArrayLike
) -> Float64MultiArray:
    """Make the message of the margins [m]: N + 1 rows of the columns that a label names.

    Terms of alpha_p without eps_s have shape (N + 1, 9), eps_s, the constant term, () or (N + 1,),
    alpha_g and slack, the violation of the tightened clearance, (N + 1,).
    """
    terms = np.asarray(by_channel, dtype=float)
    rows = np.empty((len(terms), len(COLUMNS)))
    rows[:, :N_ZETA] = terms
    for column, values in enumerate((eps_s, alpha_g, slack), start=N_ZETA):
        rows[:, column] = values
    msg = Float64MultiArray(data=array("d", rows.ravel()))
    msg.layout.dim = [
        MultiArrayDimension(label=STAGE, size=len(rows), stride=rows.size),
        MultiArrayDimension(label=",".join(COLUMNS), size=len(COLUMNS), stride=len(COLUMNS)),
    ]
    return msg


def decode(msg: Float64MultiArray) -> PublishedTightening:
    """Read the margins; raises MessageError if labels or sizes are not those of `encode`."""
    labels = [dim.label for dim in msg.layout.dim]
    if labels != [STAGE, ",".join(COLUMNS)]:
        raise MessageError(f"tightening is labelled {labels}: expected {STAGE} and {COLUMNS}")
    rows = np.array(msg.data)
    if rows.size != msg.layout.dim[0].size * len(COLUMNS):
        raise MessageError(
            f"tightening has {rows.size} numbers: expected {msg.layout.dim[0].size} stages of "
            f"{len(COLUMNS)}"
        )
    rows = rows.reshape(-1, len(COLUMNS))
    return PublishedTightening(rows[:, :N_ZETA], *rows[:, N_ZETA:].T)
