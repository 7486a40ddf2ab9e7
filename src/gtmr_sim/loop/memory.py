# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The structures of the C sources under ``c/``, field by field, and the library they make."""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_int64, c_void_p
from functools import lru_cache
from importlib.resources import files

from gtmr_codegen.library import load_library

WRITTEN = ("gtmr_loop.c", "gtmr_flight.c")
FLAGS = dict.fromkeys(WRITTEN, ("-O2", "-ffp-contract=off", "-fno-builtin-pow"))
"""Of the compiler; nothing is fused, and a power is the library's, so that results are those of
Python."""


class CAhead(ctypes.Structure):
    """``gtmr_loop_ahead``."""

    _fields_ = (("rows", c_void_p), ("count", c_int64), ("used", c_int64))


class CPlan(ctypes.Structure):
    """``gtmr_loop_plan``."""

    _fields_ = (
        ("acts", c_int64),
        ("start", c_int64),
        ("kind", c_int64),
        ("n", c_int64),
        ("has_setpoints", c_int64),
        ("u", c_void_p),
        ("setpoints_hz", c_void_p),
    )


class CLoop(ctypes.Structure):
    """``gtmr_loop``."""

    _fields_ = (
        ("step", c_int64),
        ("plan_step", c_int64),
        ("hold", c_int64),
        ("sample", c_int64),
        ("watch", c_int64),
        ("act", c_int64),
        ("step_s", c_double),
        ("n_rotors", c_int64),
        ("due", c_int64),
        ("advance", c_void_p),
        ("x", c_void_p),
        ("setpoints_hz", c_void_p),
        ("u", c_void_p),
        ("w_g", c_void_p),
        ("air_m_s", c_void_p),
        ("has_motors", c_int64),
        ("min_rotor_speed_hz", c_double),
        ("max_rotor_speed_hz", c_double),
        ("plans", ctypes.POINTER(CPlan)),
        ("plans_room", c_int64),
        ("plan_rows_room", c_int64),
        ("coming", c_int64),
        ("guard", c_void_p),
        ("guard_memory", c_void_p),
        ("guard_u", c_void_p),
        ("guard_due", c_void_p),
        ("guard_sight", c_void_p),
        ("cause", c_int64),
        ("looked", c_int64),
        ("seen", c_int64),
        ("guarded", c_int64),
        ("gust", CAhead),
        ("gust_is_inward", c_int64),
        ("gust_n", c_double * 3),
        ("has_wind", c_int64),
        ("far_m_s", c_double * 3),
        ("along", c_double * 2),
        ("reference_height_m", c_double),
        ("profile_exponent", c_double),
        ("tower_radius_m", c_double),
        ("tower_drag_coefficient", c_double),
        ("flow_around_tower", c_int64),
        ("wake", c_int64),
        ("is_turbulent", c_int64),
        ("turbulence", CAhead),
        ("has_sensor", c_int64),
        ("numbers", CAhead),
        ("noise_std", c_double * 12),
        ("bias_m", c_double * 3),
        ("bias_kept", c_double),
        ("bias_spread_m", c_double),
        ("rotor_quantum_hz", c_double),
        ("delay_s", c_double),
        ("jitter_s", c_double),
        ("dropout", c_double),
        ("way_room", c_int64),
        ("way", c_int64),
        ("way_arrives", c_void_p),
        ("way_made", c_void_p),
        ("way_x", c_void_p),
        ("newest_made", c_int64),
        ("newest_x", c_void_p),
    )


class CFlight(ctypes.Structure):
    """``gtmr_flight`` of ``c/gtmr_flight.h``."""

    _fields_ = (
        ("loop", ctypes.POINTER(CLoop)),
        ("controller", c_void_p),
        ("controller_memory", c_void_p),
        ("delay_s", c_double),
        ("transport_s", c_double),
        ("tells_now", c_int64),
        ("failed", c_int64),
        ("stages", c_int64),
        ("plan", c_void_p),
        ("u", c_void_p),
        ("setpoints_hz", c_void_p),
        ("alpha_p", c_void_p),
        ("alpha_g", c_void_p),
        ("slack", c_void_p),
        ("k", c_int64),
        ("phase", c_int64),
        ("handed_out", c_int64),
        ("stamp_s", c_double),
        ("now_s", c_double),
        ("x", c_void_p),
        ("log_x", c_void_p),
        ("log_measured", c_void_p),
        ("log_u", c_void_p),
        ("log_gust_n", c_void_p),
        ("log_air_m_s", c_void_p),
        ("log_alpha_p", c_void_p),
        ("log_alpha_g", c_void_p),
        ("log_slack", c_void_p),
        ("log_solve_ms", c_void_p),
        ("log_failed", c_void_p),
        ("log_guard", c_void_p),
    )


@lru_cache(maxsize=1)
def library() -> ctypes.CDLL:
    """Load the compiled loop, which serves any vehicle and world; raises CompileError."""
    folder = files("gtmr_sim.loop") / "c"
    names = [name.replace(".c", end) for name in WRITTEN for end in (".c", ".h")]
    sources = {name: (folder / name).read_text(encoding="utf-8") for name in names}
    loaded = load_library("the simulation", sources, FLAGS)
    loop = ctypes.POINTER(CLoop)
    loaded.gtmr_loop_size.restype = c_int64
    loaded.gtmr_loop_draw.restype = loaded.gtmr_loop_measure.restype = None
    loaded.gtmr_loop_draw.argtypes = loaded.gtmr_loop_measure.argtypes = [loop]
    loaded.gtmr_loop_advance.argtypes = [loop, c_int64]
    whole = [c_int64] * 2
    loaded.gtmr_loop_play.argtypes = [loop, *whole, ctypes.c_int, c_int64, c_void_p, c_void_p]
    loaded.gtmr_loop_newest.restype = c_int64
    loaded.gtmr_loop_newest.argtypes = [loop]
    loaded.gtmr_flight_size.restype = c_int64
    loaded.gtmr_flight_run.argtypes = [ctypes.POINTER(CFlight), c_int64]
    return loaded
