# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A stream that stops is told within 0.2 s, and one that is slow or not due is not."""

import pytest

from gtmr_msgs_py.node import silence
from gtmr_msgs_py.node.silence import LOOK_S, Silence

PROMISE_S = 0.2


class Watched:
    """A stream, and a node whose wall clock the test turns."""

    def __init__(self, monkeypatch, **options):
        self.now_s, self.told, self.said = 100.0, [], []
        monkeypatch.setattr(silence.time, "monotonic", lambda: self.now_s)
        self.silence = Silence(self, "odometry", lambda: self.told.append(self.now_s), **options)
        self._looked_s = self.now_s

    def create_timer(self, period_s, look, clock):
        self.look = look

    def get_logger(self):
        return self

    def warning(self, text):
        self.said.append(text)

    info = warning

    def go_on(self, duration_s, period_s=None):
        """Let time go by, with messages every period, or none."""
        end_s, due_s = self.now_s + duration_s, self.now_s
        while self.now_s < end_s:
            if period_s is not None and self.now_s >= due_s:
                self.silence.heard()
                due_s += period_s
            if self.now_s - self._looked_s >= LOOK_S:
                self._looked_s = self.now_s
                self.look()
            self.now_s += 0.005


@pytest.fixture
def watched(monkeypatch):
    return lambda **options: Watched(monkeypatch, **options)


@pytest.mark.parametrize("period_s", [0.005, 0.025, 0.045])
def test_what_stops_is_told_once_within_the_promise_and_again_when_it_goes_on(watched, period_s):
    stream = watched()
    stream.go_on(1.0, period_s)
    assert not stream.told
    last_s = stream.silence._heard_s
    stream.go_on(3.0)
    (told_s,) = stream.told
    assert told_s - last_s <= PROMISE_S
    assert stream.silence.silent
    stream.go_on(1.0, period_s)
    assert len(stream.told) == 2
    assert not stream.silence.silent
    assert stream.said[0].startswith("no odometry for 0.1")
    assert stream.said[1:] == ["odometry again"]


@pytest.mark.parametrize("period_s", [0.1, 1.0])
def test_what_is_slow_has_not_stopped(watched, period_s):
    stream = watched()
    stream.go_on(5.0, period_s)
    assert not stream.told
    stream.go_on(4.0 * period_s)
    assert len(stream.told) == 1


def test_what_never_began_or_is_not_due_has_not_stopped(watched):
    stream = watched()
    stream.go_on(2.0)
    assert not stream.told
    due = [True]
    stream = watched(is_due=lambda: due[0])
    stream.go_on(1.0, 0.005)
    due[0] = False
    stream.go_on(1.0)
    due[0] = True
    stream.go_on(1.0)
    assert not stream.told


def test_who_was_held_up_does_not_blame_the_stream(watched):
    stream = watched()
    stream.go_on(1.0, 0.005)
    stream.now_s += 0.5
    stream.look()
    assert not stream.told
