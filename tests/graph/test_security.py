# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the security policy allows is what the nodes do: nothing is missing, nothing is spare."""

import runpy
from pathlib import Path

from support.ros_graph import RosGraph

from gtmr_msgs_py import topics

ROOT = Path(__file__).parents[2]
NODES = ("sim", "nmpc", "monitor")


def full(node, names):
    """Names as the graph has them, for nodes in the namespace /."""
    return {f"/{node}/{n[2:]}" if n[:2] == "~/" else f"/{n.lstrip('/')}" for n in names}


def test_the_policy_allows_what_the_nodes_do_and_no_more(tmp_path):
    policy = runpy.run_path(str(ROOT / "docs" / "security.py"))
    kinds = {
        "publisher": policy["published"],
        "subscriber": policy["heard"],
        "service": policy["served"],
        "client": policy["called"],
    }
    with RosGraph() as graph:
        graph.start("gtmr_sim.node", recorders="1")
        graph.start("gtmr_nmpc.node", use_sim_time="true")
        graph.start("gtmr_monitor.node", bag=str(tmp_path / "bag"), use_sim_time="true")

        def done(node, kind):
            found = getattr(graph.node, f"get_{kind}_names_and_types_by_node")(node, "/")
            return {name for name, _ in found}

        def differences():
            if not set(NODES) <= set(graph.node.get_node_names()):
                return ["a node is missing"]
            return [
                (node, kind, name)
                for node in NODES
                for kind, allowed in kinds.items()
                for name in done(node, kind) ^ full(node, allowed(node))
                if not only_elsewhere(policy, node, name)
            ]

        try:
            graph.wait_until(lambda: not differences())
        except TimeoutError:
            assert differences() == [], "mend and run .venv/bin/python docs/security.py"


def only_elsewhere(policy, node, name):
    """Whether a name is there with lifecycle services, or with tf2_msgs, alone."""
    return name in full(node, policy["LIFECYCLE_SERVICES"]) or (name == "/tf" and not topics.TF)
