# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""CasADi functions on NumPy memory, without a conversion per call."""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Evaluator:
    """A mapped CasADi function: one row per point in, one block per point out.

    The function has one point: vectors in, dense vectors or matrices out.
    """

    def __init__(self, function: ca.Function, points: int) -> None:
        self._function = function.map(points)
        # CasADi stores columns: a point is a contiguous row here, a matrix transposed in it.
        self._inputs: list[Array] = [
            np.zeros((points, function.size1_in(i))) for i in range(function.n_in())
        ]
        self._outputs: list[Array] = [
            np.zeros((points, function.size2_out(i), function.size1_out(i)))
            for i in range(function.n_out())
        ]
        # Typed loosely: the stubs of CasADi ask for a size that its code computes itself.
        buffer: Any
        buffer, self._evaluate = self._function.buffer()
        for i, memory in enumerate(self._inputs):
            buffer.set_arg(i, memoryview(memory))  # type: ignore[arg-type]
        for i, memory in enumerate(self._outputs):
            buffer.set_res(i, memoryview(memory))  # type: ignore[arg-type]
        self._buffer = buffer

    def __call__(self, *inputs: Array) -> list[Array]:
        """Evaluate all points: one input of shape (points, n) per input of the function.

        One output each, shape (points, rows) for vectors, (points, rows, columns) for matrices;
        views that the next call overwrites.
        """
        for memory, value in zip(self._inputs, inputs, strict=True):
            memory[:] = value
        self._evaluate()
        return [
            out[:, 0, :] if out.shape[1] == 1 else out.transpose(0, 2, 1) for out in self._outputs
        ]
