# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Running statistics of solve times, deadlines and solver statuses."""

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from gtmr_model.uncertainty import CHANNELS
from gtmr_nmpc.config import ControllerConfig
from gtmr_nmpc.solution import Solution

ACTIVE_M = 1e-3
"""A tightened clearance that is met with less than this to spare counts as active [m]."""
ACTIVE_SHARE = 0.999
"""An input beyond this share of its limit counts as active [-]."""


def standing(solution: Solution, config: ControllerConfig) -> dict[str, float | int]:
    """Say where a plan stands against its constraints.

    How many stages and inputs are at their limits, the largest slack [m]; at the tightest stage,
    which comes closest to the tightened clearance, its number, what is left [m], and the margins
    by channel [m].
    """
    alpha = solution.alpha_p + solution.alpha_g
    y = config.clearance_constraint.residual(solution.x_plan, config.tower)
    tightened = y + alpha
    tightest = int(tightened.argmax())
    inputs = np.abs(solution.u_plan) / config.vehicle.max_rotor_acceleration_hz_s
    terms = zip(CHANNELS, solution.alpha_p_by_channel[tightest], strict=True)
    return {
        "active_clearance_stages": int((tightened[1:] > -ACTIVE_M).sum()),
        "active_inputs": int((inputs > ACTIVE_SHARE).sum()),
        "slack_m": float(solution.slack.max()),
        "margin_scale": solution.margin_scale,
        "tightest_stage": tightest,
        "tightest_to_spare_m": -float(tightened[tightest]),
        **{f"tightest_margin_{channel}_m": float(term) for channel, term in terms},
        "tightest_margin_gust_m": float(solution.alpha_g[tightest]),
        "tightest_margin_m": float(alpha[tightest]),
    }


class Performance:
    """Solve times, deadline misses and solver statuses over the last steps, as many as the window.

    T_s is the deadline of a step's two phases together [s].
    """

    def __init__(self, sampling_time_s: float, window: int = 400) -> None:
        self.steps = 0
        """How many steps there were since the start."""
        self.deadline_misses = 0
        """How many of them took longer than T_s."""
        self.last: Solution | None = None
        """The last step, if there was one."""
        self._deadline_s = sampling_time_s
        self._solve_s: deque[float] = deque(maxlen=window)
        self._feedback_s: deque[float] = deque(maxlen=window)
        self._latency_s: deque[float] = deque(maxlen=window)
        self._statuses: deque[str] = deque(maxlen=window)

    def add(self, solution: Solution, latency_s: float) -> None:
        """Take in a step.

        Latency is from receiving the odometry to having sent the command, wall time [s].
        """
        self.steps += 1
        self.deadline_misses += solution.timing.total_s > self._deadline_s
        self._solve_s.append(solution.timing.total_s)
        self._feedback_s.append(solution.timing.feedback_s)
        self._latency_s.append(latency_s)
        self._statuses.append(solution.status)
        self.last = solution

    def count(self, status: str) -> int:
        """Count the steps of the window that ended with a status."""
        return self._statuses.count(status)

    @property
    def last_status(self) -> str:
        """Status of the last step; ``none`` before the first."""
        return self._statuses[-1] if self._statuses else "none"

    def percentiles_ms(self) -> dict[str, float]:
        """Median, 99th percentile and maximum of the window's times [ms].

        ``solve``, ``feedback`` and ``latency``, each ``_median_ms``, ``_p99_ms`` and ``_max_ms``;
        empty before the first step.
        """
        times = {
            "solve": self._solve_s,
            "feedback": self._feedback_s,
            "latency": self._latency_s,
        }
        return {
            f"{name}_{label}_ms": 1e3 * value
            for name, values in times.items()
            if values
            for label, value in zip(
                ("median", "p99", "max"), quantiles(values, (0.5, 0.99, 1.0)), strict=True
            )
        }


def quantiles(values: Iterable[float], shares: Iterable[float]) -> list[float]:
    """Give the values below which these shares of all lie, linear in between.

    They are those of `np.quantile`, which runs through so much code that once a second it takes
    longer than a whole step.
    """
    ordered = sorted(values)
    found = []
    for share in shares:
        at = share * (len(ordered) - 1)
        below = math.floor(at)
        low, high = ordered[below], ordered[math.ceil(at)]
        found.append(low + (at - below) * (high - low))
    return found
