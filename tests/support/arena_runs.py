# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A small arena, and controllers that do in it what controllers may do."""

from gtmr_study.arena.plan import Arena, MetWorld
from gtmr_study.arena.run import fly_arena, read_flights
from gtmr_study.own_controller import OwnController

ODD = """
import time
import numpy as np
class Base:
    def __init__(self, config): self.n = config.vehicle.n_rotors
class Still(Base):
    def step(self, t, x): return np.zeros(self.n)
class Nan(Base):
    def step(self, t, x): return np.full(self.n, np.nan if t > 0.1 else 0.0)
class Raises(Base):
    def step(self, t, x): return [0.0] * self.n if t < 0.1 else 1 / 0
class Late(Base):
    def step(self, t, x): return time.sleep(0.04) or np.zeros(self.n)
"""
"""A file of controllers of one's own."""
CONTROLLERS = ("nominal", "offset_free")
OWN = ("Late", "Nan", "Raises", "Still")


def own_controllers(folder):
    file = folder / "odd.py"
    file.write_text(ODD)
    return [OwnController.named("--controllers", f"{file}:{name}") for name in OWN]


def plan(own=(), **fields):
    """Make a plan of flights so short that all of them take a second."""
    worlds = tuple(MetWorld.named(name) for name in fields.pop("worlds", ("paper", "hard")))
    names = (*fields.pop("controllers", CONTROLLERS), *(each.name for each in own))
    return Arena(
        controllers=names, own=tuple(each.fingerprint for each in own), worlds=worlds,
        **{"d_ref_m": (0.25, 0.35), "trials": 3, "seed": 4, "duration_s": 0.5} | fields,
    )  # fmt: skip


def flown_in(folder, workers=2):
    """Fly it, with the steps of the late one over their budget; gives plan, own ones, rows."""
    own = own_controllers(folder)
    arena = plan(own, step_budget_ms=30.0, patience_s=0.2)
    rows = fly_arena(arena, folder / "out", own, workers)
    return arena, own, rows


def without_times(folder):
    """Read rows but for what is measured, which no two runs have in common."""
    from gtmr_study.arena.flight import TIMES

    return read_flights(folder).drop(columns=list(TIMES))
