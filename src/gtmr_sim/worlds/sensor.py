# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Odometry as a sensor gives it: noisy, biased, late, at its own rate, with losses."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from typing_extensions import Self

from gtmr_model import YamlModel
from gtmr_model.dynamics import ATTITUDE, POSITION, ROTORS

Array = NDArray[np.float64]
Amount = Annotated[float, Field(ge=0.0)]


class Odometry(YamlModel):
    """Measurement of the state; with everything left out it is the truth, without delay."""

    position_std_m: Amount = 0.0
    """White noise of the position, per axis [m]."""
    velocity_std_m_s: Amount = 0.0
    """White noise of the velocity, per axis, world frame [m/s]."""
    attitude_std_deg: Amount = 0.0
    """White noise of roll, pitch and yaw [deg]."""
    rate_std_rad_s: Amount = 0.0
    """White noise of the body rates [rad/s]."""
    bias_std_m: Amount = 0.0
    """Stationary standard deviation of the position's bias, per axis [m]: a first-order
    Gauss-Markov process (Gelb, Applied Optimal Estimation, 1974, Sec. 3.6)."""
    bias_time_s: float = Field(60.0, gt=0.0)
    """Correlation time of that bias [s]; assumed."""
    delay_s: float = Field(0.0, ge=0.0, le=0.15)
    """Age of a measurement when it arrives, at most [s]."""
    jitter_s: Amount = 0.0
    """By how much less the age may be, evenly distributed [s]; at most ``delay_s``."""
    rate_hz: float | None = Field(None, gt=0.0)
    """How often the state is measured [Hz]; left out: at every sampling time of the controller."""
    dropout: float = Field(0.0, ge=0.0, lt=1.0)
    """Share of the measurements that never arrive [-]; the first one of a flight does."""
    rotor_quantum_hz: Amount = 0.0
    """Step in which rotor speeds are told [Hz]: telemetry of ESCs counts 100 electrical turns a
    minute (KISS telemetry protocol), which with 7 pairs of poles is 0.24 Hz."""

    @model_validator(mode="after")
    def _arrives_after_it_is_measured(self) -> Self:
        if self.jitter_s > self.delay_s:
            raise ValueError(f"jitter_s = {self.jitter_s:g}: allowed is at most delay_s")
        return self

    @property
    def is_truth(self) -> bool:
        """Whether the measurement is the state itself, without delay."""
        return self == Odometry(bias_time_s=self.bias_time_s)


class Sensor:
    """Measures a flight; times are counted in plant steps.

    Parameters
    ----------
    odometry : Odometry
        What it is like.
    rng : numpy.random.Generator
        Its own random numbers.
    step_s : float
        The plant step [s].
    period : int
        Plant steps between two measurements.
    """

    def __init__(
        self, odometry: Odometry, rng: np.random.Generator, step_s: float, period: int
    ) -> None:
        self.odometry, self._rng, self._step_s = odometry, rng, step_s
        self.period = period
        """Plant steps between two measurements."""
        self.std: Array = np.repeat(
            [
                odometry.position_std_m,
                math.radians(odometry.attitude_std_deg),
                odometry.velocity_std_m_s,
                odometry.rate_std_rad_s,
            ],
            3,
        )
        """Of the noise of position, attitude, velocity and rates, shape (12,)."""
        self.bias_kept = math.exp(-period * step_s / odometry.bias_time_s)
        """Part of the bias that is left at the next measurement [-]."""
        self.bias_spread_m = odometry.bias_std_m * math.sqrt(1.0 - self.bias_kept**2)
        """Deviation of what comes to it [m]."""
        self.bias_m: Array = odometry.bias_std_m * rng.standard_normal(3)
        """Bias of the position now, shape (3,) [m]."""
        self._on_way: list[tuple[int, int, Array]] = []
        self._newest: tuple[int, Array] | None = None

    def reading(self, x: Array) -> Array:
        """Measure a state, shape (12 + N_p,), which is then as it would arrive."""
        noise, drift = self._rng.standard_normal(12), self._rng.standard_normal(3)
        measured = x.copy()
        measured[:12] += self.std * noise
        measured[POSITION] += self.bias_m
        measured[ATTITUDE] = np.remainder(measured[ATTITUDE] + math.pi, math.tau) - math.pi
        if self.odometry.rotor_quantum_hz > 0.0:
            quantum = self.odometry.rotor_quantum_hz
            measured[ROTORS] = quantum * np.round(measured[ROTORS] / quantum)
        self.bias_m = self.bias_kept * self.bias_m + self.bias_spread_m * drift
        return measured

    def draw(self, n: int) -> Array:
        """Draw the random numbers of the next n measurements ahead, shape (n, 17).

        A row has those of the noise (12) and the bias (3), and even ones for age and loss.
        """
        rows = np.empty((n, 17))
        for row in rows:
            self._rng.standard_normal(out=row[:15])
            self._rng.random(out=row[15:])
        return rows

    def measure(self, step: int, x: Array) -> None:
        """Measure the true state, shape (12 + N_p,), at a plant step; it arrives in time."""
        measured = self.reading(x)
        early, lost = self._rng.uniform(size=2)
        if step == 0:
            # A flight goes on from one before it: its first state is known.
            self._on_way.append((step, step, measured))
        elif lost >= self.odometry.dropout:
            age_s = self.odometry.delay_s - early * self.odometry.jitter_s
            # Up to the next plant step, but for rounding.
            age = math.ceil(age_s / self._step_s - 1e-6)
            self._on_way.append((step + age, step, measured))

    def newest(self, step: int) -> tuple[int, Array] | None:
        """Give the newest measurement that has arrived by a plant step, and when it was made."""
        arrived = [each for each in self._on_way if each[0] <= step]
        if arrived:
            self._on_way = [each for each in self._on_way if each[0] > step]
            _, made, measured = max(arrived, key=lambda each: each[1])
            if self._newest is None or made > self._newest[0]:
                self._newest = made, measured
        return self._newest
