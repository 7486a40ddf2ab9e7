"""The controller in C solves the same QPs as the one in NumPy, whose solver is exchanged too."""

import os

import numpy as np
import pytest
from hard_flights import SITUATIONS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reference_qp import solve_with_qpoases

from gtmr_model import Helix, Tower, Vehicle
from gtmr_nmpc import Controller, ControllerConfig
from gtmr_nmpc.compiled import CompiledIteration
from gtmr_nmpc.interpreted import InterpretedIteration
from gtmr_nmpc.qp import CondensedQp

QPS = int(os.environ.get("GTMR_QPS", "60"))
"""How many QPs of each situation; GTMR_QPS=2000 takes half an hour."""


def difference(first, second):
    """Largest difference of two solutions in any input, state or slack."""
    return max(
        np.abs(getattr(first, name) - getattr(second, name)).max()
        for name in ("u_plan", "x_plan", "slack", "alpha_p", "alpha_p_by_channel", "alpha_g")
    )


def pair(config, mode):
    compiled = Controller(config, mode, CompiledIteration(config))
    return compiled, Controller(config, mode, InterpretedIteration(config))


def is_active(situation, solution):
    vehicle = situation.config.vehicle
    xi, u = solution.x_plan[1:, 12:], solution.u_plan
    return {
        "input": (np.abs(u) > vehicle.max_rotor_acceleration_hz_s - 1e-6).any(),
        "speed": (xi > vehicle.max_rotor_speed_hz - 1e-6).any()
        or (xi < vehicle.min_rotor_speed_hz + 1e-6).any(),
        "slack": solution.status == "softened",
    }


@pytest.mark.parametrize("name", SITUATIONS)
def test_plans_are_those_of_the_reference_with_qpoases(name, monkeypatch):
    monkeypatch.setattr(CondensedQp, "solve", solve_with_qpoases)
    situation = SITUATIONS[name]
    compiled, reference = pair(situation.config, situation.mode)
    worst, seen, qps, seed = 0.0, dict.fromkeys(("input", "speed", "slack"), 0), 0, 0
    while qps < QPS:
        compiled.reset()
        reference.reset()
        for t, x, solution in situation.fly(compiled.step, seed):
            worst = max(worst, difference(solution, reference.step(t, x)))
            for kind, active in is_active(situation, solution).items():
                seen[kind] += active
            assert solution.status != "failed"
            qps += 1
        seed += 1
    print(f"{name}: {qps} QPs, {seen}, largest difference {worst:.1e}")
    assert worst < 1e-7
