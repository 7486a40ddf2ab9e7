# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The parameters of nodes as events for a recorder, with their first values."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import Parameter, ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.qos import qos_profile_parameter_events

from gtmr_msgs_py import contract
from gtmr_msgs_py.topics import Topic

if TYPE_CHECKING:
    from rclpy.node import Node

PARAMETER_EVENTS = Topic.of(contract.PARAMETER_EVENTS, qos_profile_parameter_events)
"""Topic on which every ROS 2 node publishes changes of its parameters."""


def own_parameters(node: Node) -> ParameterEvent:
    """Make an event of all parameters of a node, without a stamp."""
    names = node.list_parameters([], 0).names
    parameters = [parameter.to_parameter_msg() for parameter in node.get_parameters(names)]
    return ParameterEvent(node=node.get_fully_qualified_name(), new_parameters=parameters)


class ParameterFetch:
    """Asks a node for all its parameters whenever it appears in the graph.

    The target is its fully qualified name; the answer is an event without a stamp.
    """

    def __init__(
        self, node: Node, target: str, on_parameters: Callable[[ParameterEvent], None]
    ) -> None:
        self._target = target
        self._on_parameters = on_parameters
        self._list = node.create_client(ListParameters, f"{target}/list_parameters")
        self._get = node.create_client(GetParameters, f"{target}/get_parameters")
        self._asked = False

    def poll(self) -> None:
        """Ask if the node is there and was not asked since it appeared."""
        if not (self._list.service_is_ready() and self._get.service_is_ready()):
            self._asked = False
        elif not self._asked:
            self._asked = True
            self._list.call_async(ListParameters.Request()).add_done_callback(self._on_names)

    def _on_names(self, future: Any) -> None:
        names = future.result().result.names
        answer = self._get.call_async(GetParameters.Request(names=names))
        answer.add_done_callback(partial(self._on_values, names))

    def _on_values(self, names: list[str], future: Any) -> None:
        event = ParameterEvent(node=self._target)
        for name, value in zip(names, future.result().values, strict=True):
            event.new_parameters.append(Parameter(name=name, value=value))
        self._on_parameters(event)
