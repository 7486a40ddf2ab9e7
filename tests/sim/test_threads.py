# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Without a compiler, too, flights share code and never memory."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from gtmr_codegen.library import CompileError
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.reference.interpreted import InterpretedIteration
from gtmr_sim import Scenario, fly, plant

CONFIG = ControllerConfig()


@pytest.fixture
def interpreted(monkeypatch):
    monkeypatch.setattr(plant, "load_generated", _no_compiler)
    plant._integrator.cache_clear()
    yield
    plant._integrator.cache_clear()


def _no_compiler(*_):
    raise CompileError("no C compiler found")


@pytest.mark.slow
@pytest.mark.usefixtures("interpreted")
def test_interpreted_flights_in_four_threads_are_those_of_one():
    def flight(seed):
        controller = Controller(CONFIG, "robust", InterpretedIteration(CONFIG))
        return fly(Scenario(seed=seed), controller, 0.1).x.tobytes()

    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(flight, range(4)))

    assert together == [flight(seed) for seed in range(4)]
