# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""Long curves with fewer points, their extremes kept."""

import numpy as np
from numpy.typing import NDArray

MOST_POINTS = 4000
"""So many points a curve of a page has at most: three for each pixel of a wide one."""


def kept(values: NDArray[np.float64], most: int = MOST_POINTS) -> NDArray[np.intp]:
    """Pick the samples of a curve that are drawn.

    Time is cut into buckets of equally many samples, and of each the smallest and the largest
    value are kept; so are the first and the last sample. No peak is lost, however short.

    Parameters
    ----------
    values : array, shape (n,)
        The curve, any unit; NaN where there is none.
    most : int, optional
        How many samples to keep at most, at least 4.

    Returns
    -------
    array, shape (m,)
        Indices of the samples kept, growing; all of them where n <= ``most``.
    """
    n = len(values)
    if n <= most:
        return np.arange(n)
    buckets = (most - 2) // 2
    starts = np.linspace(0, n, buckets + 1).astype(int)[:-1]
    bucket = np.repeat(np.arange(buckets), np.diff(np.r_[starts, n]))
    # Sorted by bucket, then by value: each bucket's first is its smallest, its last its largest.
    # NaN comes last, so it takes the place of the largest of those that are no number.
    low = np.lexsort((np.where(np.isnan(values), np.inf, values), bucket))
    high = np.lexsort((np.where(np.isnan(values), -np.inf, values), bucket))
    ends = np.r_[starts[1:], n] - 1
    return np.unique(np.r_[0, low[starts], high[ends], n - 1])
