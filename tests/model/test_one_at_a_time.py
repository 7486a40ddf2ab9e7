# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""No thread makes expressions beside another: CasADi would crash the process."""

import subprocess
import sys

import pytest

MAKES_ALL = """
import casadi as ca
import numpy as np

from gtmr_codegen.library import CompileError
from gtmr_model import dynamics
from gtmr_model.dynamics import MAKING_SYMBOLS

made, alone = 0, ca.SX.sym

def watched(*size):
    global made
    made += 1
    assert MAKING_SYMBOLS._is_owned(), "an expression is made without the lock"
    return alone(*size)

ca.SX.sym = staticmethod(watched)

from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.compiled import codegen
from gtmr_nmpc.margins import SecondOrderMargin
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_sim import Scenario, fly, plant

def no_compiler(*_):
    raise CompileError("no C compiler found")

plant.load_generated = plant.load_library = no_compiler
config = ControllerConfig.load("controller", "field")
for mode, problem in (
    ("nominal", {"clearance_of": "airframe"}),
    ("robust", {"margin": SecondOrderMargin()}),
    ("robust", {"tightening": "gradient"}),
    ("offset_free", {}),
):
    changed = ControllerConfig.parse({**config.model_dump(), **problem}, "controller")
    controller = Controller(changed, mode, InterpretedIteration(changed))
    fly(Scenario(seed=1, world="field"), controller, 0.05)
    codegen.c_sources(changed)
dynamics(np.ones(18), np.zeros(6), np.zeros(9), np.zeros(3), config.vehicle)
assert made > 50, made
"""


@pytest.mark.slow
def test_expressions_are_made_under_the_lock_alone():
    result = subprocess.run([sys.executable, "-c", MAKES_ALL], capture_output=True, text=True)

    assert result.returncode == 0, result.stderr
