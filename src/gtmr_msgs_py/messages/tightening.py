# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The margins of a controller step, stage by stage, as std_msgs/Float64MultiArray."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from std_msgs.msg import Float64MultiArray

from gtmr_model.uncertainty import N_ZETA
from gtmr_msgs_py.contract import TIGHTENING_COLUMNS as COLUMNS
from gtmr_msgs_py.contract import TIGHTENING_STAGE as STAGE
from gtmr_msgs_py.wire.fixed_cdr import FixedCdr
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
    further: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    """Further margins by label, such as ``noise`` [m], shape (N + 1,) each."""

    @property
    def alpha_p(self) -> NDArray[np.float64]:
        """Parametric margin, eq. (12), eps_s included [m], shape (N + 1,)."""
        total: NDArray[np.float64] = self.by_channel.sum(axis=-1) + self.eps_s
        return total

    @property
    def total(self) -> NDArray[np.float64]:
        """By how much the clearance is tightened, of whatever cause [m], shape (N + 1,)."""
        total: NDArray[np.float64] = self.alpha_p + self.alpha_g
        return total + sum(self.further.values())


def pack(
    by_channel: ArrayLike,
    eps_s: ArrayLike,
    alpha_g: ArrayLike,
    slack: ArrayLike,
    further: Mapping[str, ArrayLike] | None = None,
) -> bytes:
    """Make CDR bytes of a std_msgs/Float64MultiArray of the margins [m].

    It has N + 1 rows of the columns that a label names.

    Terms of alpha_p without eps_s have shape (N + 1, 9), eps_s, the constant term, () or (N + 1,),
    alpha_g and slack, the violation of the tightened clearance, (N + 1,), and so have further
    margins, by label.
    """
    more = further or {}
    labels = (*COLUMNS, *more)
    terms = np.asarray(by_channel, dtype=float)
    rows = np.empty((len(terms), len(labels)))
    rows[:, :N_ZETA] = terms
    for column, values in enumerate((eps_s, alpha_g, slack, *more.values()), start=N_ZETA):
        rows[:, column] = values
    return _layout(len(rows), labels).pack(0, rows.ravel())


def decode(msg: Float64MultiArray) -> PublishedTightening:
    """Read the margins by the labels of their columns; a margin without a column is zero.

    Raises MessageError if labels or sizes are not as `pack` makes them.
    """
    labels = [dim.label for dim in msg.layout.dim]
    columns = labels[1].split(",") if len(labels) == 2 and labels[0] == STAGE else []
    if not set(columns) & set(COLUMNS) or len(set(columns)) < len(columns):
        raise MessageError(f"tightening is labelled {labels}: expected {STAGE} and {COLUMNS}")
    values, stages = np.array(msg.data), msg.layout.dim[0].size
    if values.size != stages * len(columns):
        raise MessageError(
            f"tightening has {values.size} numbers: expected {stages} stages of {len(columns)}"
        )
    return by_label(values.reshape(stages, len(columns)), columns)


def by_label(rows: NDArray[np.float64], columns: Sequence[str]) -> PublishedTightening:
    """Sort margins [m], shape (..., N + 1, columns), by the labels of their columns."""
    told = {label: rows[..., k] for k, label in enumerate(columns)}
    zero = np.zeros(rows.shape[:-1])
    ours = [told.pop(label, zero) for label in COLUMNS]
    by_channel, (eps_s, alpha_g, slack) = np.stack(ours[:N_ZETA], axis=-1), ours[N_ZETA:]
    return PublishedTightening(by_channel, eps_s, alpha_g, slack, told)


@lru_cache(maxsize=8)
def _layout(stages: int, labels: tuple[str, ...]) -> FixedCdr:
    layout = FixedCdr()
    layout.uint32(2)
    layout.string(STAGE)
    layout.uint32(stages, stages * len(labels))
    layout.string(",".join(labels))
    layout.uint32(len(labels), len(labels))
    # The data begin at once.
    layout.uint32(0, stages * len(labels))
    layout.float64(stages * len(labels))
    return layout
