# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The controller as a ROS 2 node: odometry and rotor speeds in, the whole plan out."""

from __future__ import annotations

import os
import sys
import time
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from gtmr_model.dynamics import ATTITUDE, POSITION
from gtmr_msgs_py import topics
from gtmr_msgs_py.messages import (
    markers,
    odometry,
    path,
    rotor_command,
    rotor_states,
    solve_time,
    tightening,
)
from gtmr_msgs_py.node import diagnostics
from gtmr_msgs_py.node.diagnostics import Level
from gtmr_msgs_py.node.parameters import FrameParameters, ModelParameters
from gtmr_msgs_py.node.process import PROMPT, run
from gtmr_msgs_py.node.silence import Silence
from gtmr_msgs_py.node.suite_node import Chores, SuiteNode
from gtmr_msgs_py.wire import stamps
from gtmr_msgs_py.wire.fixed_cdr import stamp_of
from gtmr_msgs_py.wire.order import StampOrder
from gtmr_msgs_py.wire.reading import read
from gtmr_nmpc.config import MODES, ControllerConfig, Mode
from gtmr_nmpc.controller import Controller
from gtmr_nmpc.online.delay import Delay
from gtmr_nmpc.online.fitness import Fitness
from gtmr_nmpc.online.performance import Performance, standing
from gtmr_nmpc.online.plausibility import Plausibility
from gtmr_nmpc.online.schedule import Due, Schedule
from gtmr_nmpc.solution import Solution

DIAGNOSTICS_PERIOD_S = 1.0
"""Between two messages on /diagnostics, wall time [s]."""
MARKERS_PERIOD_S = 0.2
"""Between two sets of markers, odometry time [s]."""
REFERENCE_PERIOD_S = 1.0
"""Between two messages of the reference, odometry time [s]."""
REFERENCE_STEP_S = 0.5
"""Between two poses of the reference [s]."""
REFERENCE_POSES = 41
"""How many poses of the reference ahead: 20 s."""

Stamped = tuple[int, NDArray[np.float64]]
"""Stamp [ns] and what was measured then."""


class NmpcParameters(ControllerConfig, FrameParameters):
    """The parameters of the node: the controller's problem, and how it takes part in the graph."""

    controller: str = "default"
    """Name of a preset, or path of a .yaml file, whose values are the defaults of the others."""
    mode: Mode = "robust"
    """``nominal`` for eq. (5), ``robust`` for eq. (15), or ``offset_free``, which estimates its
    disturbances; may change in flight."""
    max_stamp_difference_s: float = Field(0.0, ge=0.0, le=0.1)
    """By how much the stamps of odometry and rotor states that are taken together may differ [s];
    the simulator gives both the same."""
    max_delay_s: float = Field(0.03, ge=0.0, le=10.0)
    """By how much odometry may be older than ``delay_s`` says, by the clock that its stamps are of
    [s]; of an older one no command is sent, and past the last plan the guard takes charge."""
    recorders: int = Field(0, ge=0, le=10)
    """How many recorders, such as the monitor, must listen before the first step."""


class NmpcNode(SuiteNode):
    """Runs a controller step whenever the odometry is T_s further on.

    Raises ConfigError if a parameter cannot be used.
    """

    PRESETS: ClassVar = {"margin": "paper", "vehicle": "paper"}
    """Parameters that name a preset or a file, with their defaults."""
    DYNAMIC: ClassVar = {
        "eps_s_m",
        "max_delay_s",
        "max_stamp_difference_s",
        "mode",
        "slack_l1",
        "slack_l2",
        "switch_time_s",
        "tower.min_clearance_m",
        "uncertainty",
        "weights",
    }
    """Parameters that may change in flight."""

    def __init__(self, managed: bool = False) -> None:
        super().__init__("nmpc", managed)
        self._settings = ModelParameters(
            self,
            NmpcParameters,
            self.PRESETS,
            self.DYNAMIC,
            on_change=self._change,
            base="controller",
        )

    def allocate(self) -> None:
        """Make the controller, and use it once."""
        config = self._settings.value
        self._controller = Controller(config, config.mode)
        self._warm_up()
        self._schedule = Schedule(stamps.nanoseconds(config.sampling_time_s))
        self._performance = Performance(config.sampling_time_s)
        self._odometry: Stamped | None = None
        self._odometry_order = StampOrder()
        self._rotor_states: Stamped | None = None
        self._rotor_states_order = StampOrder()
        self._last_command = b""
        self._begins_again = False
        self._plausibility = Plausibility(config.vehicle, config.offset_free.noise)
        self._delay = Delay()
        self._fitness = Fitness()
        self._withheld, self._withheld_steps = "", 0
        self._steps_reported = 0
        self._published_ns: dict[Publisher, int] = {}

        self._rotor_command = topics.ROTOR_COMMAND.publisher(self)
        self._tightening = topics.TIGHTENING.publisher(self)
        self._solve_time = topics.SOLVE_TIME.publisher(self)
        self._predicted_path = topics.PREDICTED_PATH.publisher(self)
        self._reference = topics.REFERENCE.publisher(self)
        self._markers = topics.MARKERS.publisher(self)
        self._diagnostics = topics.DIAGNOSTICS.publisher(self)

    def connect(self) -> None:
        """Subscribe to states."""
        config = self._settings.value
        self._reconfigure(config)
        self._chores = Chores(self)
        self._chores.add(DIAGNOSTICS_PERIOD_S, self._diagnose)
        self._silence = Silence(self, "odometry", self._diagnose)
        topics.CLOCK.subscription(self, self._on_clock, topics.NEWEST, raw=True)
        topics.ODOM.subscription(self, self._on_odometry, topics.NEWEST, raw=True)
        topics.ROTOR_STATES.subscription(self, self._on_rotor_states, topics.NEWEST, raw=True)
        self.get_logger().info(
            f"{config.vehicle.name}, {config.mode} mode, every {1e3 * config.sampling_time_s:g} ms"
        )

    def _warm_up(self) -> None:
        """Evaluate everything once: the first evaluation is slow, and must not be in flight."""
        config = self._settings.value
        x = config.helix.initial_state(config.tower, config.vehicle)
        for mode in MODES:
            self._controller.mode = mode
            self._controller.reset()
            for k in range(2):
                t = k * config.sampling_time_s
                self._controller.step(t, x, now=t + config.delay_s)
        self._controller.mode = config.mode
        self._controller.reset()

    def _change(self, parameters: NmpcParameters) -> None:
        if self.connected:
            self._reconfigure(parameters)

    def _reconfigure(self, parameters: NmpcParameters) -> None:
        if parameters.mode != self._controller.mode:
            self._controller.mode = parameters.mode
            self.get_logger().info(f"{parameters.mode} mode")
        self._controller.reconfigure(parameters)
        # The preparation is out of date; renewed here it costs no time in the next step.
        self._controller.prepare(self._acts_at_s(self._schedule.next_ns))

    def _acts_at_s(self, stamp_ns: int) -> float:
        """From when the command acts that is made from a state of this stamp [s]."""
        return stamps.seconds(stamp_ns) + self._settings.value.delay_s

    def _on_clock(self, data: bytes) -> None:
        stamp_ns = stamp_of(data)
        self._delay.simulated_ns = (
            stamps.decode(read(data, Clock).clock) if stamp_ns is None else stamp_ns
        )

    def _on_odometry(self, data: bytes) -> None:
        self._arrival = time.perf_counter()
        self._silence.heard()
        stamp_ns, rigid_body = odometry.unpack(data, self._settings.value.frames)
        if self._odometry_order.admit(stamp_ns):
            self._begins_again = True
            self._plausibility.reset()
        self._plausibility.check(stamp_ns, rigid_body)
        self._odometry = stamp_ns, rigid_body
        self._step_if_due()

    def _on_rotor_states(self, data: bytes) -> None:
        self._arrival = time.perf_counter()
        stamp_ns, xi = rotor_states.unpack(data, self._settings.value.vehicle.n_rotors)
        self._rotor_states_order.admit(stamp_ns)
        self._rotor_states = stamp_ns, xi
        self._step_if_due()

    def _step_if_due(self) -> None:
        state = self._take_state()
        if state is None or not self._recorders_listen():
            return
        stamp_ns, x = state
        delay_s = self._measured_delay_s(stamp_ns)
        if delay_s > self._most_delay_s:
            self._withhold(f"odometry is {delay_s:.3g} s late")
            return
        due, self._begins_again = self._schedule.admit(stamp_ns, self._begins_again), False
        if due is Due.NOTHING:
            return
        if due is Due.REPEAT:
            if self._last_command:
                self._rotor_command.publish(self._last_command)
            return
        if due is Due.RESTART:
            self._controller.reset()
        time_ns = self._schedule.time_ns
        solution = self._controller.step(stamps.seconds(time_ns), x, now=self._acts_at_s(time_ns))
        self._send(stamp_ns, x, solution)
        self._performance.add(solution, time.perf_counter() - self._arrival)
        self._publish_step(stamp_ns, solution)
        self._controller.prepare(self._acts_at_s(self._schedule.next_ns))
        if due is Due.RESTART:
            self.tell_parameters()
        elif not self._publish_scene(stamp_ns, solution):
            self._chores.do_one()

    def _send(self, stamp_ns: int, x: NDArray[np.float64], solution: Solution) -> None:
        """Send the plan, unless it is not fit: then the guard takes charge past the last one."""
        reason = self._fitness.reason(stamps.seconds(stamp_ns), x, solution)
        if reason:
            self._last_command = b""
            self._withhold(reason)
            return
        self._last_command = rotor_command.pack(
            stamp_ns + stamps.nanoseconds(self._settings.value.delay_s),
            self._schedule.period_ns,
            solution.setpoints_hz,
            solution.u_plan,
        )
        self._rotor_command.publish(self._last_command)
        # Whoever waits for it on this processor comes first.
        os.sched_yield()
        if self._withheld:
            self.get_logger().info("commands are sent again")
            self._withheld = ""

    def _withhold(self, reason: str) -> None:
        """Report why no command is sent, at once if the reason is new."""
        news, self._withheld = not self._withheld, reason
        self._withheld_steps += 1
        if news:
            self.get_logger().error(f"no command is sent: {reason}")
            self._diagnose()

    @property
    def _most_delay_s(self) -> float:
        """Age up to which odometry is acted upon [s]."""
        return self._settings.value.delay_s + self._settings.value.max_delay_s

    def _measured_delay_s(self, stamp_ns: int) -> float:
        """How late odometry is [s]; zero where that is not known."""
        delay_s = self._delay.measure(stamp_ns, time.time_ns())
        if delay_s is None:
            return 0.0
        if delay_s > self._most_delay_s:
            clock = self.resolve_topic_name(topics.CLOCK.name)
            if self._delay.simulated_ns is not None and self.count_publishers(clock) > 1:
                # With several simulations it is not known which one's time it is.
                self._delay.last_s = None
                return 0.0
        return delay_s

    def _take_state(self) -> Stamped | None:
        """Odometry and rotor states that belong together, once, whichever came first."""
        if self._odometry is None or self._rotor_states is None:
            return None
        (stamp_ns, rigid_body), (rotors_stamp_ns, xi) = self._odometry, self._rotor_states
        if abs(stamp_ns - rotors_stamp_ns) > stamps.nanoseconds(
            self._settings.value.max_stamp_difference_s
        ):
            return None
        self._odometry = self._rotor_states = None
        return stamp_ns, np.concatenate([rigid_body, xi])

    def _recorders_listen(self) -> bool:
        """Whether every recorder that was asked for gets what a step publishes."""
        recorders = self._settings.value.recorders
        if recorders == 0 or self._performance.steps > 0:
            return True
        counts = [p.get_subscription_count() for p in (self._tightening, self._solve_time)]
        # The simulator subscribes to the command too.
        counts.append(self._rotor_command.get_subscription_count() - 1)
        return min(counts) >= recorders

    def _publish_step(self, stamp_ns: int, solution: Solution) -> None:
        self._tightening.publish(
            tightening.pack(
                solution.alpha_p_by_channel,
                solution.eps_s,
                solution.tightening.gust,
                solution.slack,
                {"noise": solution.tightening.noise},
            )
        )
        self._solve_time.publish(solve_time.encode(solution.timing.total_s))
        self._predicted_path.publish(
            path.pack(
                stamp_ns,
                self._schedule.period_ns,
                solution.x_plan[:, POSITION],
                solution.x_plan[:, ATTITUDE],
                self._settings.value.world_frame,
            )
        )

    def _publish_scene(self, stamp_ns: int, solution: Solution) -> bool:
        """Publish what is not of every step, if it is time for it and somebody listens.

        Says whether it did; one thing is enough after one step, or the next odometry has to wait.
        """
        config = self._settings.value
        if self._is_time_for(self._reference, stamp_ns, REFERENCE_PERIOD_S):
            times = stamps.seconds(stamp_ns) + REFERENCE_STEP_S * np.arange(REFERENCE_POSES)
            ahead = config.helix.at(times, config.tower)
            level = np.zeros_like(ahead.yaw)
            self._reference.publish(
                path.pack(
                    stamp_ns,
                    stamps.nanoseconds(REFERENCE_STEP_S),
                    ahead.position,
                    np.stack([level, level, ahead.yaw], axis=1),
                    config.world_frame,
                )
            )
            return True
        if self._is_time_for(self._markers, stamp_ns, MARKERS_PERIOD_S):
            mode, planned = self._controller.mode, solution.x_plan[:, POSITION]
            margins_m = solution.alpha_p + solution.alpha_g
            shells = markers.tightened_shells(config.tower, margins_m, planned[:, 2], mode)
            plan = markers.plan(planned, mode)
            self._markers.publish(markers.encode(stamp_ns, shells + plan, config.world_frame))
            return True
        return False

    def _is_time_for(self, publisher: Publisher, stamp_ns: int, period_s: float) -> bool:
        last_ns = self._published_ns.get(publisher)
        if last_ns is not None and 0 <= stamp_ns - last_ns < stamps.nanoseconds(period_s):
            return False
        self._published_ns[publisher] = stamp_ns
        return bool(publisher.get_subscription_count())

    def _diagnose(self) -> None:
        performance, config = self._performance, self._settings.value
        last = performance.last
        level, message = Level.OK, "in time"
        if not self._recorders_listen():
            level, message = Level.STALE, "waiting for a recorder"
        elif self._silence.silent:
            level, message = Level.STALE, "odometry has stopped"
        elif self._withheld:
            level, message = Level.ERROR, f"no command is sent: {self._withheld}"
        elif performance.steps == self._steps_reported:
            level, message = Level.STALE, "no odometry to act upon"
        elif performance.count("failed"):
            level, message = Level.ERROR, "the QP solver gave up"
        elif performance.count("limited"):
            level, message = Level.WARN, "the QP solver stopped before its solution"
        elif performance.count("softened"):
            level, message = Level.WARN, "the tightened clearance is violated"
        self._steps_reported = performance.steps
        self._diagnostics.publish(
            diagnostics.pack(
                self.get_clock().now().nanoseconds,
                f"{diagnostics.source(self)}: controller",
                level,
                message,
                {
                    "mode": self._controller.mode,
                    "qp_status": performance.last_status,
                    "steps": performance.steps,
                    "deadline_misses": performance.deadline_misses,
                    "skipped_steps": self._schedule.skipped,
                    "withheld_commands": self._withheld_steps,
                    "delay_s": "unknown" if self._delay.last_s is None else self._delay.last_s,
                    **self.drops.figures(),
                    "callback_errors": self.callback_errors,
                    "softened_in_window": performance.count("softened"),
                    "limited_in_window": performance.count("limited"),
                    "failed_in_window": performance.count("failed"),
                    **performance.percentiles_ms(),
                    **(standing(last, config) if last else {}),
                },
                hardware_id=config.vehicle.name,
            )
        )


def main(args: list[str] | None = None) -> int:
    """Run the node ``nmpc``; exit codes and arguments are those of `run`."""
    return run(NmpcNode, args, PROMPT)


if __name__ == "__main__":
    sys.exit(main())
