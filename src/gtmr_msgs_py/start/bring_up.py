# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Configures and activates a managed node, whatever its state.

``python3 -m gtmr_msgs_py.start.bring_up NODE`` ends with exit code 0 once the node is active, and
1 if it refuses, as with a parameter that cannot be used: its own log says why. Until the node is
there, it is waited for.
"""

from __future__ import annotations

import sys
from typing import Any

import rclpy
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gtmr_msgs_py.start.parent import end_with_parent

ANSWER_S = 2.0
"""How long to wait for an answer before asking again [s]: a node may have died over it, and
another come in its place."""
NEXT = {
    State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_CONFIGURE,
    State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_ACTIVATE,
}
"""What leads on from each state."""


def bring_up(node: Node, name: str) -> bool:
    """Lead the node of a name, namespace included, to be active; False if it refuses."""
    state_client = node.create_client(GetState, f"{name}/get_state")
    change_client = node.create_client(ChangeState, f"{name}/change_state")
    refused = None
    while True:
        answer = _ask(node, state_client, GetState.Request())
        if answer is None:
            continue
        state = answer.current_state
        if state.id == State.PRIMARY_STATE_ACTIVE:
            return True
        if state.id == State.PRIMARY_STATE_FINALIZED or state.id == refused:
            return False
        if state.id in NEXT:
            request = ChangeState.Request(transition=Transition(id=NEXT[state.id]))
            changed = _ask(node, change_client, request)
            # Another one may have led it on meanwhile: only its state tells.
            refused = state.id if changed is not None and not changed.success else None


def _ask(node: Node, client: Any, request: Any) -> Any:
    """Call a service; None if there is no answer in time."""
    if not client.wait_for_service(ANSWER_S):
        return None
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=ANSWER_S)
    return future.result() if future.done() else None


def main() -> int:
    """Bring up the node whose name is the first argument."""
    end_with_parent()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("bring_up")
    try:
        active = bring_up(node, sys.argv[1])
        if not active:
            sys.stderr.write(f"error: {sys.argv[1]} cannot be made active: its log says why\n")
        return 0 if active else 1
    except KeyboardInterrupt:
        return 0
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
