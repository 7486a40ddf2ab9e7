# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Runs the controller on what a bag recorded, step by step as the node ran it."""

from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gtmr_model import Vehicle
from gtmr_model.dynamics import POSITION
from gtmr_monitor.bag.format import BagError
from gtmr_monitor.bag.recording import Recorded, Recording
from gtmr_msgs_py.messages import rotor_command
from gtmr_msgs_py.messages.rotor_command import RotorPlan
from gtmr_msgs_py.wire import stamps
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_nmpc import Controller, ControllerConfig, Mode, Solution
from gtmr_nmpc.online.schedule import Due, Schedule
from gtmr_study.ros.replay.parameters import RecordedParameters
from gtmr_study.ros.replay.result import Replay, Step
from gtmr_study.ros.replay.rotor_speeds import SOURCES, RotorSpeeds
from gtmr_study.ros.replay.states import State, usable_states

Array = NDArray[np.float64]
OnStep = Callable[[int, int], None]
"""Told how many of how many steps are done."""


def replay(
    recording: Recording,
    mode: Mode | None = None,
    config: ControllerConfig | None = None,
    vehicle: Vehicle | None = None,
    on_step: OnStep | None = None,
) -> Replay:
    """Run the controller on recorded odometry and rotor speeds.

    A step is made for every recorded command, from the odometry that it answers, as the node made
    it: by the same schedule, with the parameters and the mode of that moment. Without recorded
    commands the schedule alone says when.

    A mode or problem that is given holds throughout; if left out it is as recorded, the mode
    robust where that is not recorded. A vehicle that is given replaces the recorded one, or that
    of ``config``. ``on_step`` is called after every step.

    Raises ConfigError if the recorded parameters make no configuration, BagError if no recorded
    command answers an odometry of the bag.
    """
    parameters = RecordedParameters(recording, mode, config, vehicle)
    first = parameters.config
    notes = list(recording.notes)
    states = usable_states(recording, notes)
    delay_ns = stamps.nanoseconds(first.delay_s)
    occasions = _occasions(recording, states, delay_ns, notes)
    # The time of somebody else's flight has nothing to do with that of the reference.
    begin_ns = 0 if recording.commands else states[0].stamp_ns
    speeds = RotorSpeeds(recording, first.vehicle, parameters.max_stamp_difference_ns)
    controller = Controller(first, parameters.mode)
    schedule = Schedule(stamps.nanoseconds(first.sampling_time_s))
    steps: list[Step] = []
    for k, (state, command) in enumerate(occasions, start=1):
        if parameters.advance(state.received_ns if command is None else command.sent_ns):
            _reconfigure(controller, parameters)
        due = schedule.admit(state.stamp_ns - begin_ns)
        if due in (Due.STEP, Due.RESTART):
            recorded = _plan(command, first.vehicle.n_rotors)
            xi, source = speeds.at(state, recorded)
            t = stamps.seconds(schedule.time_ns)
            x = np.r_[state.rigid_body, xi]
            solution = controller.step(t, x, now=t + controller.config.delay_s)
            steps.append(_step(state.stamp_ns, controller, source, solution, recorded))
            # As the node does: a step then takes the time that it takes in flight.
            controller.prepare(stamps.seconds(schedule.next_ns) + controller.config.delay_s)
        if on_step is not None:
            on_step(k, len(occasions))
    notes += _remarks(recording, steps, speeds)
    return Replay(recording, first, steps, parameters.guessed, notes)


def _occasions(
    recording: Recording, states: list[State], delay_ns: int, notes: list[str]
) -> list[tuple[State, Recorded | None]]:
    """List the odometry to plan from, with the command that answered it if there is one."""
    if not recording.commands:
        notes.append(
            "the bag holds no rotor_command: nothing is compared, and the reference begins with "
            "the first odometry"
        )
        return [(state, None) for state in states]
    by_stamp = {state.stamp_ns + delay_ns: state for state in states}
    answers = [c for c in recording.commands if c.stamp_ns in by_stamp]
    if not answers:
        raise BagError(
            f"{recording.path}: no rotor_command has the stamp of an odometry on {recording.odom}"
        )
    missing = len(recording.commands) - len(answers)
    if missing:
        notes.append(f"{missing} commands answer odometry that is not in the bag: left out")
    return [(by_stamp[command.stamp_ns], command) for command in answers]


def _reconfigure(controller: Controller, parameters: RecordedParameters) -> None:
    """Change the controller between two steps, as the node does."""
    if parameters.mode != controller.mode:
        controller.mode = parameters.mode
    if parameters.config != controller.config:
        try:
            controller.reconfigure(parameters.config)
        except ValueError:
            raise BagError(
                f"{parameters.source}: the controller was started again for another problem, "
                "which one replay cannot follow"
            ) from None


def _plan(command: Recorded | None, n_rotors: int) -> RotorPlan | None:
    if command is None:
        return None
    try:
        return rotor_command.decode(command.message, n_rotors)
    except MessageError:
        return None


def _step(
    stamp_ns: int,
    controller: Controller,
    rotor_source: str,
    solution: Solution,
    recorded: RotorPlan | None,
) -> Step:
    config = controller.config
    return Step(
        stamp_ns=stamp_ns,
        mode=controller.mode,
        rotor_source=rotor_source,
        by_channel=np.array(solution.alpha_p_by_channel),
        eps_s=np.array(solution.eps_s),
        alpha_g=np.array(solution.alpha_g),
        slack=np.array(solution.slack),
        foreseen=float(config.tower.residual(solution.x_plan[-1, POSITION])),
        failed=solution.status == "failed",
        solve_s=solution.timing.total_s,
        difference=None if recorded is None else _difference(solution.u_plan, recorded, config),
    )


def _difference(u_plan: Array, recorded: RotorPlan, config: ControllerConfig) -> float:
    # Plans of another sampling time have only their first instant in common.
    same_grid = recorded.step_ns == stamps.nanoseconds(config.sampling_time_s)
    n = min(len(u_plan), len(recorded.u)) if same_grid else 1
    return float(np.abs(u_plan[:n] - recorded.u[:n]).max())


def _remarks(recording: Recording, steps: list[Step], speeds: RotorSpeeds) -> list[str]:
    remarks = []
    if speeds.renamed:
        remarks.append(f"the rotors of {recording.rotors} have other names: taken in their order")
    sources = Counter(step.rotor_source for step in steps)
    remarks += [
        f"rotor speeds of {sources[name]} of {len(steps)} steps: {meaning}"
        for name, meaning in SOURCES.items()
        if name != "recorded" and sources[name]
    ]
    unread = sum(step.difference is None for step in steps) if recording.commands else 0
    if unread:
        remarks.append(f"{unread} recorded commands are not for these rotors: not compared")
    return remarks
