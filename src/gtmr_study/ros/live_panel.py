# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The controls of the live page: what may be changed in flight, and which moment is shown."""

import html
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import viser

from gtmr_nmpc import MODES

AS_IT_FLIES = "as it flies"
"""Instead of the name of a flight: the one that is being flown."""
MOST_WIND_N = 1.0
MOST_GUST_N = 0.6
"""How far the sliders go [N]; what the simulator does not take it refuses."""
MOST_PACE = 4.0
"""How much faster than real time the slider goes."""
SCRUB_STEP_S = 0.05
"""Step of the slider through a flight [s]."""


class Panel:
    """Controls for flights of ``duration_s`` [s], on a page that viser serves."""

    def __init__(self, gui: viser.GuiApi, duration_s: float, modes: Sequence[str]) -> None:
        self.on_change: Callable[[str, Any], None] = lambda *_: None
        """Told what somebody chose: the name of a parameter, ``pause`` or ``wind``; a value."""
        self.on_scrub: Callable[[str, float], None] = lambda *_: None
        """Told which moment of which flight somebody wants to see [s]."""
        self.flying_mode = modes[0]
        """The mode of the controller that flies."""
        self._duration_s, self._modes, self._flight = duration_s, list(modes), modes[0]
        # viser's own types take the value of a control for one that cannot be set.
        with gui.add_folder("Look back"):
            self._flights: Any = gui.add_dropdown(
                "Flight", (AS_IT_FLIES, *modes), initial_value=AS_IT_FLIES
            )
            self._time: Any = gui.add_slider(
                "Time [s]", 0.0, max(duration_s, SCRUB_STEP_S), SCRUB_STEP_S, 0.0
            )
            self._playing: Any = gui.add_checkbox(
                "Play", False, hint="Let the time go on by itself"
            )
        with gui.add_folder("Change in flight"):
            self._mode: Any = gui.add_dropdown("Mode", MODES, initial_value=modes[0])
            self._pause: Any = gui.add_checkbox("Pause", initial_value=False)
            self._pace: Any = gui.add_slider("Pace", 0.1, MOST_PACE, 0.1, 1.0)
            self._wind: list[Any] = [
                gui.add_slider(f"Wind {axis} [N]", -MOST_WIND_N, MOST_WIND_N, 0.05, 0.0)
                for axis in "xyz"
            ]
            self._gust: Any = gui.add_slider("Gust [N]", 0.0, MOST_GUST_N, 0.05, 0.25)
            self._answer = gui.add_html("")
        self._flights.on_update(self._flight_was_chosen)
        self._time.on_update(self._time_was_chosen)
        named = {"mode": self._mode, "pause": self._pause, "real_time_factor": self._pace}
        for name, control in {**named, "gust.std_n": self._gust}.items():
            control.on_update(partial(self._chosen, name))
        for control in self._wind:
            control.on_update(partial(self._chosen, "wind"))

    @property
    def following(self) -> bool:
        """Whether the page shows what is being flown."""
        return bool(self._flights.value == AS_IT_FLIES)

    def follow(self, mode: str) -> None:
        """Begin a flight in a mode."""
        self._flight = self.flying_mode = mode
        self._pause.value = False

    def flown(self) -> None:
        """Take away what needs a flight; all of them can be looked back at."""
        for control in (self._mode, self._pause, self._pace, *self._wind, self._gust):
            control.disabled = True
        last = self._flight
        self._flights.options = tuple(self._modes)
        self._flights.value = last

    def at(self, time_s: float) -> None:
        """Say which time of the flight is shown [s]."""
        self._time.value = min(max(time_s, 0.0), self._time.max)

    def play(self, passed_s: float) -> None:
        """Let so much time go by [s], if somebody wants it to."""
        if self._playing.value and not self.following:
            later = self._time.value + passed_s
            self.at(later if later <= self._duration_s else 0.0)
            self.on_scrub(self._flights.value, self._time.value)

    def set(self, name: str, value: Any) -> None:
        """Show the value that a parameter has."""
        if name == "zeta":
            for control, force_n in zip(self._wind, value[6:], strict=True):
                control.value = min(max(force_n, -MOST_WIND_N), MOST_WIND_N)
        elif name == "mode":
            self._mode.value = value
        elif name == "gust.std_n":
            self._gust.value = min(value, MOST_GUST_N)
        elif name == "real_time_factor":
            self._pace.value = min(max(value, self._pace.min), MOST_PACE)

    def tell(self, answer: str) -> None:
        """Say why a value was refused; nothing if none was."""
        said = f'<div class="gtmr"><span class="bad">{html.escape(answer)}</span></div>'
        self._answer.content = said if answer else ""

    def _chosen(self, name: str, event: Any) -> None:
        # What the page itself sets has no client.
        if event.client is not None:
            wind = name == "wind"
            value = [control.value for control in self._wind] if wind else event.target.value
            self.on_change(name, value)

    def _flight_was_chosen(self, event: Any) -> None:
        if event.client is not None and not self.following:
            self.on_scrub(self._flights.value, self._time.value)

    def _time_was_chosen(self, event: Any) -> None:
        if event.client is None:
            return
        if self.following:
            self._flights.value = self._flight
        self.on_scrub(self._flights.value, self._time.value)
