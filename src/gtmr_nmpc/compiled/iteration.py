# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The real-time iteration in C: the sources under ``c/``, compiled for one problem."""

from __future__ import annotations

import ctypes
import math
from functools import lru_cache
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from gtmr_codegen.library import load_generated
from gtmr_model import N_ZETA
from gtmr_nmpc import ocp
from gtmr_nmpc.compiled import codegen
from gtmr_nmpc.compiled.codegen import BODY
from gtmr_nmpc.config import ControllerConfig
from gtmr_nmpc.iteration import IterationResult
from gtmr_nmpc.margins import Iterate, Tightening
from gtmr_nmpc.margins.paper import gust_margin
from gtmr_nmpc.observer import N_THETA, Estimate, bounds, gains, gust_decay
from gtmr_nmpc.solution import Status

Array = NDArray[np.float64]

STATUSES: tuple[Status, ...] = ("solved", "softened", "failed", "limited")
"""By ``gtmr_status``."""
Part = tuple[int, tuple[int, ...]]
"""Where in a plan an array begins, in entries, and its shape."""
ALIGNMENT = 64
"""Of a controller's memory [bytes]."""


class CParameters(ctypes.Structure):
    """``gtmr_parameters`` of ``c/gtmr.h``."""

    _fields_ = (
        ("tower_radius_m", ctypes.c_double),
        ("min_clearance_m", ctypes.c_double),
        ("reference", ctypes.c_double * codegen.MAX_REFERENCE_NUMBERS),
        ("min_rotor_speed_hz", ctypes.c_double),
        ("max_rotor_speed_hz", ctypes.c_double),
        ("max_rotor_acceleration_hz_s", ctypes.c_double),
        ("stage_weights", ctypes.c_double * ocp.N_H),
        ("input_weight", ctypes.c_double),
        ("terminal_weights", ctypes.c_double * 3),
        ("half_widths", ctypes.c_double * N_ZETA),
        ("eps_s_m", ctypes.c_double),
        ("gust_m", ctypes.c_double),
        ("slack_l1", ctypes.c_double),
        ("slack_l2", ctypes.c_double),
        ("with_margin_gradient", ctypes.c_double),
        ("translation_gains", ctypes.c_double * 8),
        ("rotation_gains", ctypes.c_double * 18),
        ("theta_bounds", ctypes.c_double * N_THETA),
        ("gust_decay", ctypes.c_double),
        ("gust_time_s", ctypes.c_double),
        ("motor_lag_s", ctypes.c_double),
        ("delay_s", ctypes.c_double),
    )


def parameters(config: ControllerConfig, observes: bool) -> CParameters:
    """All that the compiled controller takes from a problem at run time.

    The observer's gains are left out unless it is used, as they take longest to compute.
    """
    tower, vehicle, weights = config.tower, config.vehicle, config.weights
    first_gust_m = gust_margin(config.uncertainty, vehicle, 1, config.sampling_time_s)[1]
    observer = {}
    if observes:
        by = gains(config)
        inertia = np.array(vehicle.inertia_kg_m2)
        scale = np.stack([np.ones((3, 2)), np.ones((3, 2)), np.tile(inertia[:, None], 2)], axis=1)
        observer = {
            "translation_gains": tuple(by.translation.ravel()),
            "rotation_gains": tuple((by.rotation * scale).ravel()),
            "theta_bounds": tuple(bounds(config)),
        }
    return CParameters(
        tower_radius_m=tower.radius_m,
        min_clearance_m=tower.min_clearance_m,
        reference=tuple(config.helix.numbers),
        min_rotor_speed_hz=vehicle.min_rotor_speed_hz,
        max_rotor_speed_hz=vehicle.max_rotor_speed_hz,
        max_rotor_acceleration_hz_s=vehicle.max_rotor_acceleration_hz_s,
        stage_weights=tuple(ocp.stage_weights(config)),
        input_weight=weights.rotor_acceleration,
        terminal_weights=weights.terminal_position,
        half_widths=tuple(config.uncertainty.half_widths),
        eps_s_m=config.eps_s_m,
        gust_m=first_gust_m,
        slack_l1=config.slack_l1,
        slack_l2=config.slack_l2,
        with_margin_gradient=float(config.tightening == "gradient"),
        gust_decay=gust_decay(config),
        gust_time_s=config.offset_free.disturbance.gust_time_s,
        motor_lag_s=config.motor_lag_s,
        delay_s=config.delay_s,
        **observer,
    )


class CompiledIteration:
    """An `Iteration` in C; CompileError if it is not in the cache and there is no compiler."""

    def __init__(self, config: ControllerConfig) -> None:
        n, n_x, n_u = config.horizon, config.vehicle.n_x, config.vehicle.n_rotors
        self._config = config
        self.library = library = _library(_compiled_part(config))
        memory = np.zeros(library.gtmr_size() + ALIGNMENT, np.uint8)
        # The library has no memory of its own: this array must live as long as the controller.
        self._memory = memory
        address = memory.ctypes.data + -memory.ctypes.data % ALIGNMENT
        self.controller = ctypes.c_void_p(address)
        self._observes = False
        library.gtmr_create(self.controller, ctypes.byref(self._parameters()))

        self._eps_s = self._no_noise = np.zeros(n + 1)
        self._x = np.zeros(n_x)
        self._x_address = ctypes.c_void_p(self._x.ctypes.data)
        self._plan = np.zeros(library.gtmr_plan_length())
        self._plan_address = ctypes.c_void_p(self._plan.ctypes.data)
        shapes: dict[str, tuple[int, ...]] = {
            "x_plan": (n + 1, n_x),
            "u_plan": (n, n_u),
            "alpha_p_by_channel": (n + 1, N_ZETA),
            "alpha_p": (n + 1,),
            "alpha_g": (n + 1,),
            "slack": (n + 1,),
            "setpoints_hz": (n + 1, n_u),
            "observed_steps": (),
            "times_s": (2,),
        }
        starts = accumulate(map(math.prod, shapes.values()), initial=0)
        self.parts = {
            name: (start, shapes[name]) for start, name in zip(starts, shapes, strict=False)
        }

    @property
    def sizes(self) -> tuple[int, int]:
        """Bytes of a controller's memory, and entries of a plan, for users of the C library."""
        return self.library.gtmr_size(), self.library.gtmr_plan_length()

    @property
    def passes(self) -> int:
        """How many passes the active set took in the last step."""
        return int(self.library.gtmr_passes(self.controller))

    @property
    def guesses(self) -> int:
        """How many guesses of what is at the rotors' bounds the last step took.

        0 if none was needed, -1 if none was right and the active set solved the whole QP.
        """
        return int(self.library.gtmr_guesses(self.controller))

    def reconfigure(self, config: ControllerConfig) -> None:
        """See `Iteration.reconfigure`."""
        self._config = config
        self.library.gtmr_reconfigure(self.controller, ctypes.byref(self._parameters()))

    def observer(self) -> CompiledObserver:
        """See `Iteration.observer`."""
        self._observes = True
        self.reconfigure(self._config)
        return CompiledObserver(self.library, self.controller, self)

    def _parameters(self) -> CParameters:
        return parameters(self._config, self._observes)

    def cold(self, x: Array) -> None:
        """See `Iteration.cold`."""
        self._x[:] = x
        self.library.gtmr_cold(self.controller, self._x_address)

    def warm(self, steps: int) -> None:
        """See `Iteration.warm`."""
        self.library.gtmr_warm(self.controller, steps)

    def disturb(self, theta: Array | None) -> None:
        """See `Iteration.disturb`."""
        address = None if theta is None else ctypes.c_void_p(theta.ctypes.data)
        self.library.gtmr_disturb(self.controller, address)

    def prepare(self, t: float, margin_scale: float) -> None:
        """See `Iteration.prepare`."""
        eps_s_m = margin_scale * self._config.eps_s_m
        if self._eps_s[0] != eps_s_m:
            self._eps_s = np.full(self._config.horizon + 1, eps_s_m)
        self._given: Tightening | None = None
        self.library.gtmr_prepare(
            self.controller, ctypes.c_double(t), ctypes.c_double(margin_scale)
        )

    def linearised(self) -> Iterate:
        """See `Iteration.linearised`."""
        n, vehicle = self._config.horizon, self._config.vehicle
        x, u = np.empty((n + 1, vehicle.n_x)), np.empty((n, vehicle.n_rotors))
        body = np.empty((n + 1, BODY.stop, N_ZETA))
        addresses = (ctypes.c_void_p(array.ctypes.data) for array in (x, u, body))
        self.library.gtmr_iterate(self.controller, *addresses)
        # Rotor speeds do not depend on zeta.
        rotors = ((0, 0), (0, vehicle.n_rotors), (0, 0))
        return Iterate(self._config, x, u, lambda: np.pad(body, rotors))

    def tighten(self, tightening: Tightening) -> None:
        """See `Iteration.tighten`."""
        self._given = tightening
        alpha = np.ascontiguousarray(tightening.total)
        self.library.gtmr_tighten(self.controller, ctypes.c_void_p(alpha.ctypes.data))

    def feedback(self, x: Array) -> IterationResult:
        """See `Iteration.feedback`."""
        self._x[:] = x
        status = self.library.gtmr_feedback(self.controller, self._x_address, self._plan_address)
        plan = self._plan.copy()
        x, u, by_channel, _, alpha_g, slack, *_ = (
            np.ndarray(shape, float, plan, 8 * start) for start, shape in self.parts.values()
        )
        tightening = self._given or Tightening(by_channel, self._eps_s, alpha_g, self._no_noise)
        return IterationResult(x, u, tightening, slack, STATUSES[status])


class CompiledObserver:
    """An `Observer` in C, in the memory of a compiled iteration."""

    def __init__(
        self, library: ctypes.CDLL, controller: ctypes.c_void_p, owner: CompiledIteration
    ) -> None:
        self._library, self._controller, self._owner = library, controller, owner

    def reconfigure(self, config: ControllerConfig) -> None:
        """See `Observer.reconfigure`."""
        self._owner.reconfigure(config)

    def reset(self) -> None:
        """See `Observer.reset`."""
        self._library.gtmr_forget(self._controller)

    def update(self, x: Array, dt_s: float) -> Estimate:
        """See `Observer.update`."""
        estimate = np.empty(len(x) + N_THETA)
        self._library.gtmr_observe(
            self._controller,
            ctypes.c_void_p(x.ctypes.data),
            ctypes.c_double(dt_s),
            ctypes.c_void_p(estimate.ctypes.data),
        )
        return Estimate(estimate[:-N_THETA], estimate[-N_THETA:])

    def ahead(self, x: Array, xi: Array, dt_s: float) -> Array:
        """See `Observer.ahead`."""
        moved = np.empty(len(x))
        self._library.gtmr_ahead(
            self._controller,
            ctypes.c_void_p(x.ctypes.data),
            ctypes.c_void_p(xi.ctypes.data),
            ctypes.c_double(dt_s),
            ctypes.c_void_p(moved.ctypes.data),
        )
        return moved


def _compiled_part(config: ControllerConfig) -> ControllerConfig:
    """Keep only what the sources depend on, so that the rest does not compile them again."""
    return ControllerConfig(
        vehicle=config.vehicle,
        helix=config.helix.form,
        horizon=config.horizon,
        sampling_time_s=config.sampling_time_s,
        clearance_of=config.clearance_of,
    )


@lru_cache(maxsize=16)
def _library(config: ControllerConfig) -> ctypes.CDLL:
    def make() -> tuple[dict[str, str], dict[str, tuple[str, ...]]]:
        sources = codegen.c_sources(config)
        return sources, codegen.flags(sources)

    values = (config, codegen.GENERATED_FLAGS, codegen.WRITTEN_FLAGS, codegen.UNFUSED_FLAGS)
    library = load_generated("the controller", "gtmr_nmpc", values, make)
    library.gtmr_size.restype = library.gtmr_plan_length.restype = ctypes.c_size_t
    library.gtmr_create.restype = ctypes.c_void_p
    for name in (
        "reconfigure",
        "cold",
        "warm",
        "disturb",
        "prepare",
        "iterate",
        "tighten",
        "forget",
        "observe",
        "ahead",
        "reset",
        "set_mode",
        "set_margins",
    ):
        getattr(library, f"gtmr_{name}").restype = None
    state, time, plan = ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p
    library.gtmr_begin.argtypes = (ctypes.c_void_p, time, state, time)
    library.gtmr_step.argtypes = (ctypes.c_void_p, time, state, time, plan)
    library.gtmr_set_mode.argtypes = (ctypes.c_void_p, ctypes.c_double, ctypes.c_double)
    library.gtmr_last_time.restype = ctypes.c_double
    return library
