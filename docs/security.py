# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Writes config/security/gtmr.policy.xml, what each node needs and nothing else, from the code.

Run `.venv/bin/python docs/security.py`. The format is that of SROS 2; a test compares the file
with this and with what the nodes do.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

from gtmr_msgs_py import contract, topics
from gtmr_msgs_py.contract import TopicName

POLICY = Path(__file__).parents[1] / "config" / "security" / "gtmr.policy.xml"
NODES = ("sim", "nmpc", "monitor")
RECORDER = "monitor"
"""Listens to whatever the others publish, and asks the other nodes for their parameters."""
EVERY_NODE_PUBLISHES = ("/parameter_events", "/rosout", "~/transition_event")
PARAMETER_SERVICES = (
    "~/describe_parameters",
    "~/get_parameter_types",
    "~/get_parameters",
    "~/get_type_description",
    "~/list_parameters",
    "~/set_parameters",
    "~/set_parameters_atomically",
)
LIFECYCLE_SERVICES = (
    "~/change_state",
    "~/get_available_states",
    "~/get_available_transitions",
    "~/get_state",
    "~/get_transition_graph",
)
"""Of managed nodes."""
ASKED_BY_RECORDER = ("get_parameters", "list_parameters")
COMMENT = """ Written by docs/security.py from the code; a test holds the two together.
     Each node has an enclave of its own, for the namespace / alone. """


def policy() -> str:
    """Return the policy of all nodes, as XML."""
    root = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(root, "enclaves")
    for node in NODES:
        enclave = ElementTree.SubElement(enclaves, "enclave", path=f"/gtmr/{node}")
        profiles = ElementTree.SubElement(enclave, "profiles")
        profile = ElementTree.SubElement(profiles, "profile", ns="/", node=node)
        _allow(profile, "topic", "publish", published(node))
        _allow(profile, "topic", "subscribe", heard(node))
        _allow(profile, "service", "reply", served(node))
        _allow(profile, "service", "request", called(node))
    ElementTree.indent(root)
    body = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<!--{COMMENT}-->\n{body}\n'


def published(node: str) -> set[str]:
    """Names of the topics that a node publishes."""
    return {topic.name for topic in _topics() if node in topic.publishers} | {
        *EVERY_NODE_PUBLISHES
    }


def heard(node: str) -> set[str]:
    """Names of the topics that a node subscribes to."""
    if node == RECORDER:
        others = (topic for topic in _topics() if topic.publishers != (RECORDER,))
        return {topic.name for topic in others} | {"/parameter_events"}
    return {topic.name for topic in _topics() if node in topic.subscribers}


def served(node: str) -> set[str]:
    """Names of the services that a node answers."""
    own = {service.name for service in topics.SERVICES if service.server == node}
    return own | {*PARAMETER_SERVICES, *LIFECYCLE_SERVICES}


def called(node: str) -> set[str]:
    """Names of the services that a node asks."""
    if node != RECORDER:
        return set()
    others = (other for other in NODES if other != node)
    return {f"{other}/{service}" for other in others for service in ASKED_BY_RECORDER}


def _topics() -> list[TopicName]:
    # Published only where tf2_msgs is installed, as it is with ROS.
    return [*(topic for topic in topics.TOPICS if topic is not topics.TF), contract.TF]


def _allow(profile: ElementTree.Element, what: str, deed: str, names: Iterable[str]) -> None:
    sorted_names = sorted(names)
    if not sorted_names:
        return
    allowed = ElementTree.SubElement(profile, f"{what}s", {deed: "ALLOW"})
    for name in sorted_names:
        ElementTree.SubElement(allowed, what).text = name


def main() -> None:
    """Write the file."""
    POLICY.parent.mkdir(exist_ok=True)
    POLICY.write_text(policy(), encoding="utf-8")


if __name__ == "__main__":
    main()
