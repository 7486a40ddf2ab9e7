# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a node does now and then waits until the control loop has been served."""

from gtmr_msgs_py.node.suite_node import Chores


class Node:
    """Has timers that the test lets expire."""

    def __init__(self):
        self.expire, self.done = {}, []
        self.chores = Chores(self)
        for period_s, name in ((1.0, "report"), (0.05, "draw")):
            self.chores.add(period_s, lambda name=name: self.done.append(name))

    def create_timer(self, period_s, callback, clock):
        self.expire[period_s] = callback


def test_one_chore_is_done_after_each_command_the_oldest_first():
    node = Node()
    node.chores.do_one()
    assert node.done == ["report"]
    node.expire[1.0]()
    for _ in range(3):
        node.chores.do_one()
    assert node.done == ["report", "draw", "report"]


def test_without_commands_chores_are_done_once_a_period():
    node = Node()
    for _ in range(3):
        node.expire[1.0]()
    assert node.done == ["report"] * 3


def test_a_chore_that_is_due_waits_for_the_command_rather_than_for_its_timer():
    node = Node()
    node.chores.do_one()
    node.chores.do_one()
    node.done.clear()
    node.expire[0.05]()
    assert node.done == []
    node.chores.do_one()
    assert node.done == ["draw"]
