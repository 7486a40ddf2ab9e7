# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is kept of a flight: rows in time, figures of them, and a file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gtmr_model import ConfigError
from gtmr_model.yaml_file import printable
from gtmr_sim.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

AXES = ("x", "y", "z")
TURNS = ("roll", "pitch", "yaw")


class FlightFileError(ValueError):
    """A file that holds no whole flight; the message is one line naming it and what is wrong."""

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


@dataclass(frozen=True, repr=False, eq=False)
class FlightLog:
    """A flight, one row per sampling time t_k = k T_s.

    Where no measurement had arrived for a new step, the rows of what the controller told are those
    of the step before. What it does not tell is no number: its margins and slack have shape
    (K, 0), and ``failed`` has shape (0,).
    """

    t: Array
    """[s], shape (K,)."""
    x: Array
    """True state at t_k, shape (K, 12 + N_p)."""
    x_measured: Array
    """State that the controller had at t_k, the newest that had arrived, shape (K, 12 + N_p)."""
    u: Array
    """Rotor accelerations commanded over [t_k, t_k + T_s) [Hz/s], shape (K, N_p)."""
    zeta: Array
    """True mismatch and wind bias, eq. (4), shape (9,)."""
    w_g: Array
    """Gust force held over [t_k, t_k + T_s), world frame [N], shape (K, 3)."""
    d_T: Array
    """Clearance at t_k [m], shape (K,)."""
    d_airframe: Array
    """Clearance of the airframe, its nearest rotor disc, at t_k [m], shape (K,)."""
    alpha_p: Array
    """Parametric margins of step k, eq. (12) [m], shape (K, N + 1)."""
    alpha_g: Array
    """Gust margins of step k, eq. (13) [m], shape (K, N + 1)."""
    slack: Array
    """Slack of step k [m], shape (K, N + 1)."""
    solve_ms: Array
    """Time of step k [ms], shape (K,): the controller's own, else measured around ``step``."""
    failed: NDArray[np.bool_]
    """Whether the QP solver gave up in step k, shape (K,)."""
    guard: NDArray[np.bool_]
    """Whether the guard was in charge at the end of step k, shape (K,)."""
    least_clearance_m: float
    """Least d_T of any plant step, the start included [m]."""
    wind_n: Array
    """Force of the wind from t_k on, on the vehicle at hover, world frame [N], shape (K, 3); w_b
    where the world has no wind field."""
    steady_wind_within: float
    """Share of time that what is steady of the wind's force, its mean over `STEADY_S`, was within
    the bounds of w_b [-]."""
    gusts_within: float
    """Share of time that the rest of it and ``w_g`` together were within the bound of w_g [-]."""

    sampling_time_s: float
    """T_s [s]."""
    mode: str
    """Who flew: the mode of the suite's controller, or the class of another."""
    scenario: Scenario
    """What was flown in."""

    def __repr__(self) -> str:
        """Say in one line which flight it is."""
        return (
            f"FlightLog({self.mode}, {self.duration_s:g} s in {len(self.t)} steps, "
            f"least clearance {self.least_clearance_m:.3f} m)"
        )

    @property
    def duration_s(self) -> float:
        """Length of the flight [s]."""
        return len(self.t) * self.sampling_time_s

    @property
    def failed_steps(self) -> int | None:
        """In how many steps the QP solver gave up; None if the controller does not tell."""
        return int(self.failed.sum()) if self.failed.size else None

    @property
    def max_slack_m(self) -> float | None:
        """Largest slack of any stage and step [m]; None if the controller does not tell."""
        return float(self.slack.max()) if self.slack.size else None

    @property
    def softened_steps(self) -> int | None:
        """In how many steps there was slack; None if the controller does not tell."""
        if not self.slack.size:
            return None
        return int((self.slack.max(axis=1) > SLACK_TOLERANCE_M).sum())

    @property
    def radial_error_m(self) -> Array:
        """Clearance minus that of the reference, positive away from the tower [m], shape (K,)."""
        scenario = self.scenario
        error: Array = self.d_T - scenario.helix.clearance(self.t, scenario.tower)
        return error

    @property
    def tracking_error_m(self) -> Array:
        """Distance of the vehicle's centre from the reference, in all axes [m], shape (K,)."""
        reference = self.scenario.helix.at(self.t, self.scenario.tower).position
        return np.asarray(np.linalg.norm(self.x[:, :3] - reference, axis=1))

    def summary(self) -> dict[str, Any]:
        """Give the flight in figures, as ``gtmr fly --json`` writes them.

        Lengths are in m, times in s or ms as the names say; None is what the controller does not
        tell. ``residual_m`` is of s = d_min - d_T at sampling times; ``violated`` is whether it is
        above zero at any; errors are root mean squares over the whole flight.

        Raises ValueError if the flight diverged, so that its clearance is not finite.
        """
        if not np.isfinite(self.d_T).all():
            raise ValueError("the flight diverged: its clearance is not finite")
        d_min = self.scenario.tower.min_clearance_m
        residual = d_min - self.d_T
        names = ("min", "q1", "median", "q3", "max")
        quartiles = np.percentile(residual, (0, 25, 50, 75, 100)).tolist()
        solve_ms = np.percentile(self.solve_ms, (50, 99, 100)).tolist()
        return {
            "mode": self.mode,
            "seed": self.scenario.seed,
            "duration_s": self.duration_s,
            "gust": self.scenario.gust.kind,
            "zeta": self.zeta.tolist(),
            "min_clearance_m": d_min - quartiles[-1],
            "violated": quartiles[-1] > 0.0,
            "samples": len(self.t),
            "residual_m": dict(zip(names, quartiles, strict=True)),
            "min_airframe_clearance_m": float(self.d_airframe.min()),
            "min_clearance_any_time_m": self.least_clearance_m,
            "radial_rms_m": _rms(self.radial_error_m),
            "tracking_rms_m": _rms(self.tracking_error_m),
            "max_slack_m": self.max_slack_m,
            "softened_steps": self.softened_steps,
            "solve_ms": dict(zip(("median", "p99", "max"), solve_ms, strict=True)),
            "failed_steps": self.failed_steps,
            "guard_time_s": float(self.guard.sum()) * self.sampling_time_s,
            "steady_wind_within": self.steady_wind_within,
            "gusts_within": self.gusts_within,
        }

    def to_pandas(self) -> pd.DataFrame:
        """Make a table of it, one row a sampling time, by time [s].

        Columns end with their unit. Of the margins and the slack, which each stage has, it is the
        largest; a controller that does not tell has no such columns.
        """
        import pandas as pd

        columns: dict[str, NDArray[Any]] = {}
        columns |= _columns("p_{}_m", AXES, self.x[:, :3])
        columns |= _columns("{}_rad", TURNS, self.x[:, 3:6])
        columns |= _columns("v_{}_m_s", AXES, self.x[:, 6:9])
        columns |= _columns("omega_{}_rad_s", AXES, self.x[:, 9:12])
        rotors = tuple(str(k) for k in range(self.u.shape[1]))
        columns |= _columns("xi_{}_hz", rotors, self.x[:, 12:])
        columns |= _columns("u_{}_hz_s", rotors, self.u)
        columns |= _columns("gust_{}_n", AXES, self.w_g)
        columns |= _columns("wind_{}_n", AXES, self.wind_n)
        columns |= {"clearance_m": self.d_T, "airframe_clearance_m": self.d_airframe}
        columns |= {"radial_error_m": self.radial_error_m}
        columns |= {"tracking_error_m": self.tracking_error_m}
        for name in ("alpha_p", "alpha_g", "slack"):
            by_stage = getattr(self, name)
            if by_stage.size:
                columns[f"{name}_m"] = by_stage.max(axis=1)
        columns |= {"solve_ms": self.solve_ms, "guard": self.guard}
        if self.failed.size:
            columns["failed"] = self.failed
        return pd.DataFrame(columns, index=pd.Index(self.t, name="t_s"))

    def plot(self) -> Any:
        """Draw clearance, tracking error, margins with slack, and rotor speeds over time.

        Gives matplotlib's axes, one below the other, as pandas does: ``plt.show()`` shows them,
        ``axes[0].figure.savefig("flight.png")`` keeps them.
        """
        from gtmr_sim.flying.drawing import draw

        return draw(self)

    def save(self, file: Path | BinaryIO) -> None:
        """Write every field to a compressed npz file, by its path or already open."""
        data = {f.name: getattr(self, f.name) for f in fields(self)}
        # Only what a scenario has: a node's has more.
        data["scenario"] = self.scenario.model_dump_json(include=set(Scenario.model_fields))
        np.savez_compressed(file, **data)

    @classmethod
    def load(cls, path: str | Path) -> FlightLog:
        """Read what `save` wrote; nothing in the file is run.

        Raises FlightFileError if it cannot be read, is broken, or holds no whole flight.
        """
        try:
            with Path(path).open("rb") as stream, np.load(stream) as file:
                data = {f.name: file[f.name] for f in fields(cls) if f.name in file}
        except OSError as error:
            reason = error.strerror or "is no npz file"
            raise FlightFileError(f"{path}: {reason}") from None
        except Exception:
            # NumPy, zipfile and zlib have many words for what is broken, or no such file at all.
            raise FlightFileError(f"{path}: is no npz file, or a broken one") from None
        missing = [f.name for f in fields(cls) if f.name not in data]
        if missing:
            raise FlightFileError(
                f"{path}: is no flight that gtmr wrote: there is no {missing[0]}"
            )
        try:
            scenario = Scenario.parse(json.loads(str(data.pop("scenario")[()])), "scenario")
            log = cls(**{name: _scalar(array) for name, array in data.items()}, scenario=scenario)
            _require_whole(log)
        except json.JSONDecodeError:
            raise FlightFileError(f"{path}: scenario is none") from None
        except (ConfigError, ValueError) as error:
            raise FlightFileError(f"{path}: {error}") from None
        return log


SLACK_TOLERANCE_M = 1e-9
"""Slack below this is rounding of the QP solver [m]."""


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _columns(name: str, of: tuple[str, ...], rows: Array) -> Mapping[str, Array]:
    return {name.format(each): rows[:, k] for k, each in enumerate(of)}


def _scalar(array: NDArray[Any]) -> Any:
    """Take a number or text out of the array of no axes that a file keeps it in."""
    return array[()].item() if array.ndim == 0 else array


def _require_whole(log: FlightLog) -> None:
    """Check types and shapes, and that the rows belong together; raises ValueError if not."""
    if not (isinstance(log.t, np.ndarray) and log.t.ndim == 1 and log.t.size):
        raise ValueError("t has no rows")
    steps, n_rotors = len(log.t), log.scenario.vehicle.n_rotors
    n_x = 12 + n_rotors
    shapes: dict[str, tuple[int | None, ...]] = {
        "x": (steps, n_x),
        "x_measured": (steps, n_x),
        "u": (steps, n_rotors),
        "zeta": (9,),
        "w_g": (steps, 3),
        "d_T": (steps,),
        "d_airframe": (steps,),
        **dict.fromkeys(("alpha_p", "alpha_g", "slack"), (steps, None)),
        "solve_ms": (steps,),
        "failed": (steps if np.size(log.failed) else 0,),
        "guard": (steps,),
        "wind_n": (steps, 3),
    }
    for name, shape in {"t": (steps,), **shapes}.items():
        array = getattr(log, name)
        kind = "b" if name in ("failed", "guard") else "f"
        if not isinstance(array, np.ndarray) or array.dtype.kind != kind:
            raise ValueError(f"{name} does not hold {'yes and no' if kind == 'b' else 'numbers'}")
        if array.ndim != len(shape) or any(
            n not in (None, m) for n, m in zip(shape, array.shape, strict=True)
        ):
            raise ValueError(
                f"{name} has shape {array.shape}, which does not go with {steps} steps"
            )
    for name in ("least_clearance_m", "sampling_time_s", "steady_wind_within", "gusts_within"):
        if not isinstance(getattr(log, name), float):
            raise ValueError(f"{name} is no number")
    if not isinstance(log.mode, str):
        raise ValueError("mode is no text")
    if not log.sampling_time_s > 0.0 or not np.allclose(
        log.t, log.sampling_time_s * np.arange(steps), atol=1e-6
    ):
        raise ValueError("t is not a row of sampling times")
    if not np.allclose(log.d_T, log.scenario.tower.clearance(log.x), equal_nan=True, atol=1e-9):
        raise ValueError("d_T is not the clearance of x from the tower")
