# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A flight waits for its controller, ends in time, and takes only commands that are its own."""

import numpy as np
import pytest

from gtmr_sim import Scenario, Simulation
from gtmr_sim.session import Session

T_S = 0.025
T_S_NS = 25_000_000
HOLD = np.zeros((20, 6))


def session(tick_s=T_S, lockstep=False, duration_s=0.0):
    return Session(Simulation(Scenario(), T_S), T_S, tick_s, lockstep, duration_s)


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_flight_waits_for_the_command_of_time_zero(lockstep):
    flight = session(lockstep=lockstep)
    assert not flight.ready
    assert not flight.command(T_S_NS, HOLD)
    assert flight.command(0, HOLD)
    assert flight.ready


def test_in_lockstep_every_instant_waits_for_its_command():
    flight = session(lockstep=True)
    flight.command(0, HOLD)
    flight.advance()
    assert flight.awaits_command
    assert not flight.command(0, HOLD)
    assert flight.command(T_S_NS, HOLD)
    assert flight.ready


def test_without_lockstep_time_goes_on_and_missing_commands_are_counted():
    flight = session(tick_s=0.005)
    flight.command(0, HOLD)
    for _ in range(15):
        assert flight.ready
        flight.advance()
    assert flight.missed_commands == 2
    assert flight.command_age_s == pytest.approx(0.075)


def test_a_plan_for_a_state_too_old_is_not_taken():
    flight = session(tick_s=0.005)
    flight.command(0, HOLD)
    for _ in range(20):
        flight.advance()
    assert not flight.command(35_000_000, HOLD)
    assert flight.command(40_000_000, HOLD)


def test_a_command_from_before_a_reset_is_not_taken():
    flight = session()
    flight.command(0, HOLD)
    flight.advance()
    flight.command(T_S_NS, HOLD)
    flight.reset()
    assert flight.stamp_ns == 0
    assert not flight.command(T_S_NS, HOLD)
    assert not flight.ready


def test_a_flight_is_over_when_it_has_lasted_as_long_as_it_should():
    flight = session(duration_s=2 * T_S)
    flight.command(0, HOLD)
    flight.advance()
    assert not flight.over
    flight.advance()
    assert flight.over
    assert not flight.ready


def test_a_paused_flight_is_not_ready():
    flight = session()
    flight.command(0, HOLD)
    flight.paused = True
    assert not flight.ready
    flight.paused = False
    assert flight.ready
