# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The simulator as a ROS 2 node: plays the plan, publishes odometry, rotor speeds and time."""

from __future__ import annotations

import sys
import time
from typing import ClassVar

from pydantic import Field, ValidationInfo, field_validator, model_validator
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from typing_extensions import Self

from gtmr_model.dynamics import POSITION, ROTORS
from gtmr_msgs_py import topics
from gtmr_msgs_py.messages import markers, odometry, rotor_command, rotor_states, transforms
from gtmr_msgs_py.messages.rotor_command import RotorPlan
from gtmr_msgs_py.node import diagnostics
from gtmr_msgs_py.node.diagnostics import Level
from gtmr_msgs_py.node.parameters import FrameParameters, ModelParameters
from gtmr_msgs_py.node.process import PROMPT, run
from gtmr_msgs_py.node.silence import Silence
from gtmr_msgs_py.node.suite_node import Chores, SuiteNode
from gtmr_msgs_py.wire import stamps
from gtmr_msgs_py.wire.fixed_cdr import stamp_alone
from gtmr_msgs_py.wire.message_error import MessageError
from gtmr_sim.scenario import Scenario, whole_steps
from gtmr_sim.session import Session
from gtmr_sim.simulation import Simulation

DIAGNOSTICS_PERIOD_S = 1.0
"""Between two messages on /diagnostics, wall time [s]."""
MARKERS_PERIOD_S = 0.05
"""Between two sets of markers, wall time [s]: often enough for a vehicle that moves."""
RESEND_PERIOD_S = 0.1
"""How long a state waits for an answer before it is published again, wall time [s]."""
DELIVERY_TIMEOUT_S = 2.0
"""How long the end of a flight waits for slow recorders, wall time [s]."""
PACE_HELD = 0.9
"""Share of the real-time factor below which the simulator warns that it cannot keep up."""
WARNING_PERIOD_S = 5.0
"""Least time between two warnings about the same [s]."""


class SimParameters(Scenario, FrameParameters):
    """The parameters of the node: the flight's scenario, and the pace of time."""

    sample_zeta: bool = False
    """Whether to draw zeta from the uncertainty set by the seed; ``zeta`` then tells it."""
    sampling_time_s: float = Field(0.025, gt=0.0, le=0.5)
    """T_s, time between two points of the controller's plan [s]."""
    lockstep: bool = False
    """Whether to wait at every sampling time for the command computed from its odometry."""
    real_time_factor: float = Field(1.0, ge=0.0, le=100.0)
    """Simulated time per wall time, at most [s/s]; 0 is as fast as possible, in lockstep only."""
    odometry_rate_hz: float = Field(200.0, gt=0.0, le=1000.0)
    """How often the state is published, simulated time [Hz]; in lockstep it is once per sampling
    time instead."""
    duration_s: float = Field(0.0, ge=0.0)
    """When the flight is over and the node ends, simulated time [s]; 0 is never."""
    recorders: int = Field(0, ge=0, le=10)
    """How many recorders, such as the monitor, must listen beside the controller before the
    flight starts."""

    @field_validator("real_time_factor")
    @classmethod
    def _free_running_needs_lockstep(cls, value: float, info: ValidationInfo) -> float:
        if value == 0.0 and not info.data.get("lockstep", False):
            raise ValueError("as fast as possible needs lockstep, or commands come too late")
        return value

    @model_validator(mode="after")
    def _whole_ticks(self) -> Self:
        period_s, tick_s = self.sampling_time_s, self.tick_s
        whole_steps("sampling_time_s", period_s, "step_s", self.step_s)
        if not self.lockstep:
            whole_steps("the period of odometry_rate_hz", tick_s, "step_s", self.step_s)
            whole_steps("sampling_time_s", period_s, "the period of odometry_rate_hz", tick_s)
        return self

    def settled(self) -> SimParameters:
        """Return the same parameters with ``zeta`` drawn if it shall be."""
        if not self.sample_zeta:
            return self
        return self.model_copy(update={"zeta": self.sampled().zeta})

    @property
    def tick_s(self) -> float:
        """Simulated time between two odometry messages [s]."""
        return self.sampling_time_s if self.lockstep else 1.0 / self.odometry_rate_hz


class SimNode(SuiteNode):
    """Flies a scenario in real time, or in lockstep with the controller.

    Raises ConfigError if a parameter cannot be used.
    """

    PRESETS: ClassVar = {"vehicle": "paper", "world": "paper"}
    """Parameters that name a preset or a file, with their defaults."""
    DYNAMIC: ClassVar = {
        "gust",
        "real_time_factor",
        "tower.min_clearance_m",
        "uncertainty",
        "zeta",
    }
    """Parameters that may change in flight."""

    def __init__(self, managed: bool = False) -> None:
        super().__init__("sim", managed)
        self._settings = ModelParameters(
            self,
            SimParameters,
            self.PRESETS,
            self.DYNAMIC,
            settle=SimParameters.settled,
            on_change=self._reconfigure,
        )

    def allocate(self) -> None:
        """Make the plant, at the start of the flight."""
        scenario = self._settings.value
        self._session = Session(
            Simulation(scenario, scenario.sampling_time_s),
            scenario.sampling_time_s,
            scenario.tick_s,
            scenario.lockstep,
            scenario.duration_s,
        )
        self._commands = rotor_command.Reader(scenario.vehicle.n_rotors)
        self._published_at = 0.0
        self._played_ns = 0
        self._guard_told = ""
        self._pace_held = scenario.real_time_factor
        self._reported = (time.monotonic(), 0)

        self._clock_time = topics.CLOCK.publisher(self)
        self._odometry = topics.ODOM.publisher(self)
        self._truth = topics.GROUND_TRUTH.publisher(self)
        self._rotor_states = topics.ROTOR_STATES.publisher(self)
        self._guard = topics.GUARD.publisher(self)
        self._markers = topics.MARKERS.publisher(self)
        self._transform = None if topics.TF is None else topics.TF.publisher(self)
        self._diagnostics = topics.DIAGNOSTICS.publisher(self)

    def connect(self) -> None:
        """Subscribe to commands, and start the time."""
        scenario = self._settings.value
        self._session.reconfigure(scenario)
        self.create_service(topics.RESET.service, topics.RESET.name, self._reset)
        self.create_service(topics.PAUSE.service, topics.PAUSE.name, self._pause)
        # This node makes the simulated time, so its own timers use a clock that it cannot stop.
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(scenario.tick_s, self._tick, clock=wall)
        self._set_pace()
        self.create_timer(0.5 * RESEND_PERIOD_S, self._resend, clock=wall)
        self._chores = Chores(self)
        self._chores.add(MARKERS_PERIOD_S, self._draw)
        self._chores.add(DIAGNOSTICS_PERIOD_S, self._diagnose)
        self._silence = Silence(self, "rotor_command", self._diagnose, self._is_flying)
        topics.ROTOR_COMMAND.subscription(self, self._on_command, topics.NEWEST, raw=True)
        zeta = ", ".join(f"{value:.3g}" for value in scenario.zeta)
        self.get_logger().info(
            f"{scenario.vehicle.name}, zeta = [{zeta}], waits for {self._missing()}"
        )

    def _set_pace(self) -> None:
        scenario = self._settings.value
        if scenario.real_time_factor > 0.0:
            period_s = scenario.tick_s / scenario.real_time_factor
            self._timer.timer_period_ns = stamps.nanoseconds(period_s)
            self._timer.reset()
        else:
            self._timer.cancel()

    def _reconfigure(self, parameters: SimParameters) -> None:
        if not self.connected:
            return
        self._session.reconfigure(parameters)
        self._set_pace()
        self._tick_if_unpaced()

    def _on_command(self, data: bytes) -> None:
        self._silence.heard()
        scenario = self._settings.value
        plan = self._commands.unpack(data)
        if plan.step_ns != stamps.nanoseconds(scenario.sampling_time_s):
            raise MessageError(
                f"rotor_command has points every {stamps.seconds(plan.step_ns)} s: expected "
                f"sampling_time_s = {scenario.sampling_time_s} s"
            )
        self._play(plan)
        # The time to the next command is longest now.
        self._chores.do_one()

    def _is_flying(self) -> bool:
        session = self._session
        return session.started and not (session.paused or session.over)

    def _play(self, plan: RotorPlan) -> None:
        first = not self._session.started
        if self._session.command(plan.stamp_ns, plan.u, plan.xi):
            self._played_ns = plan.stamp_ns
            if first:
                self._reported = (time.monotonic(), self._session.stamp_ns)
                self.get_logger().info("flying")
                self.tell_parameters()
            self._tick_if_unpaced()
        elif first or plan.stamp_ns != self._played_ns:
            # A repeated plan answers a state that was published again.
            now_ns = self._session.stamp_ns
            raise MessageError(
                f"rotor_command for {stamps.seconds(plan.stamp_ns)} s at "
                f"{stamps.seconds(now_ns)} s",
                "future" if plan.stamp_ns > now_ns else "late",
            )

    def _tick_if_unpaced(self) -> None:
        """Without a real-time factor, time advances as soon as it may."""
        # Where nothing new was measured no command comes, and nothing else would wake the node.
        while self._settings.value.real_time_factor == 0.0 and self._session.ready:
            self._tick()

    def _tick(self) -> None:
        if not self._session.ready:
            return
        self._session.advance()
        self._publish_state(self._session.is_new)
        self._tell_guard()
        if self._session.over:
            self._end()

    def _publish_state(self, measured: bool) -> None:
        """Publish the true state, and what was measured if there is anything to tell."""
        session, frames = self._session, self._settings.value.frames
        stamp_ns, x = session.stamp_ns, session.x
        if measured:
            # The controller waits for these two.
            made_ns, seen = session.measured_ns, session.measured_x
            self._odometry.publish(odometry.pack(made_ns, seen, frames))
            self._rotor_states.publish(rotor_states.pack(made_ns, seen[ROTORS]))
        self._truth.publish(odometry.pack(stamp_ns, x, frames))
        self._clock_time.publish(stamp_alone(stamp_ns))
        if self._transform is not None:
            self._transform.publish(transforms.pack(stamp_ns, x, frames))
        self._guard.publish(Bool(data=bool(self._session.guard_active)))
        self._published_at = time.monotonic()

    def _tell_guard(self) -> None:
        """Report at once whether the guard takes charge, and why."""
        cause = self._session.guard_cause
        if cause == self._guard_told:
            return
        self._guard_told = cause
        if cause:
            self.get_logger().warning(f"the guard is in charge: {cause}")
        else:
            self.get_logger().info("the controller is in charge again")
        self._diagnose()

    def _resend(self) -> None:
        """Publish a state again that has no answer: some are lost while nodes connect."""
        if self._session.paused or not self._session.awaits_command:
            return
        if time.monotonic() - self._published_at >= RESEND_PERIOD_S and self._is_heard():
            self._publish_state(measured=True)

    def _is_heard(self) -> bool:
        """Whether the controller and all recorders are there; asked for only before the start."""
        if self._session.started:
            return True
        return self._listeners() >= 1 + self._settings.value.recorders

    def _listeners(self) -> int:
        return min(p.get_subscription_count() for p in (self._odometry, self._rotor_states))

    def _missing(self) -> str:
        """Say which node keeps the flight from starting."""
        commands = self.count_publishers(self.resolve_topic_name(topics.ROTOR_COMMAND.name))
        recorders = self._settings.value.recorders - (self._listeners() - min(commands, 1))
        missing = [] if commands else ["a controller"]
        if recorders > 0:
            missing.append("a recorder" if recorders == 1 else f"{recorders} recorders")
        return " and ".join(missing) or "the controller's first command"

    def _end(self) -> None:
        """End the process once every recorder has acknowledged the whole flight."""
        self.get_logger().info(f"flown {stamps.seconds(self._session.stamp_ns):g} s")
        self._diagnose()
        for publisher in (
            self._odometry,
            self._rotor_states,
            self._truth,
            self._clock_time,
            self._diagnostics,
        ):
            publisher.wait_for_all_acked(Duration(seconds=DELIVERY_TIMEOUT_S))
        self.over = True

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._session.reset()
        response.success, response.message = True, "back at the start, waiting for a controller"
        return response

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._session.paused = bool(request.data)
        response.success, response.message = True, "paused" if request.data else "going on"
        # A command that came while paused is waiting to be played.
        self._tick_if_unpaced()
        return response

    def _draw(self) -> None:
        if self._markers.get_subscription_count() == 0:
            return
        scenario = self._settings.value
        x = self._session.x
        # All in one message: who looks at one moment of a bag has the last message only.
        scene = markers.tower(scenario.tower) + markers.vehicle(scenario.vehicle, x)
        scene += markers.guard(x[POSITION], self._session.guard_cause)
        self._markers.publish(markers.encode(self._session.stamp_ns, scene, scenario.world_frame))

    def _diagnose(self) -> None:
        scenario, session, now = self._settings.value, self._session, time.monotonic()
        then, then_ns = self._reported
        if now - then > 0.5 * DIAGNOSTICS_PERIOD_S:
            # A message between two periods says nothing about the pace.
            self._reported = (now, session.stamp_ns)
            self._pace_held = stamps.seconds(session.stamp_ns - then_ns) / (now - then)
        held = self._pace_held
        level, message = Level.OK, "flying"
        if session.paused:
            # Also before a flight begins: as long as it is paused, it cannot.
            message = "paused"
        elif not session.started:
            level, message = Level.STALE, f"waiting for {self._missing()}"
        elif session.over:
            message = "the flight is over"
        elif session.guard_active:
            level, message = Level.WARN, f"the guard is in charge: {session.guard_cause}"
        elif self._silence.silent:
            level, message = Level.WARN, "rotor_command has stopped"
        elif session.command_age_s > session.usual_age_s + scenario.sampling_time_s:
            level, message = Level.WARN, "no new commands: playing the rest of the last plan"
        elif 0.0 <= held < PACE_HELD * scenario.real_time_factor:
            level, message = Level.WARN, "slower than real_time_factor asks for"
        clock = self._clock_time.topic_name
        if self.count_publishers(clock) > 1:
            level = max(level, Level.WARN)
            message += f"; {clock} has several publishers"
            self.get_logger().warning(
                f"{clock} has several publishers, and so several times: give each simulator a "
                "namespace and remap /clock to clock, or a ROS_DOMAIN_ID of its own",
                throttle_duration_sec=WARNING_PERIOD_S,
            )
        self._diagnostics.publish(
            diagnostics.pack(
                # Simulated time is known here first.
                session.stamp_ns,
                f"{diagnostics.source(self)}: simulator",
                level,
                message,
                {
                    "time_s": stamps.seconds(session.stamp_ns),
                    "real_time_factor": held,
                    "real_time_factor_asked": scenario.real_time_factor,
                    "command_age_ms": 1e3 * session.command_age_s,
                    "plan_step": session.plan_step,
                    "missed_commands": session.missed_commands,
                    "gust": scenario.gust.kind,
                    "guard": session.guard_active,
                    "guard_cause": session.guard_cause,
                    "guard_time_s": session.guard_time_s,
                    **self.drops.figures(),
                    "callback_errors": self.callback_errors,
                },
                hardware_id=scenario.vehicle.name,
            )
        )


def main(args: list[str] | None = None) -> int:
    """Run the node ``sim``; exit codes and arguments are those of `run`."""
    return run(SimNode, args, PROMPT)


if __name__ == "__main__":
    sys.exit(main())
