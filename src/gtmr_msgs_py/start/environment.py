# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The environment in which the suite's nodes run as child processes on one machine."""

import os
import sys
from importlib.resources import files

from gtmr_msgs_py.start.parent import bound_to_this_process

SINGLE_THREADED_ALGEBRA = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}
"""Keeps linear algebra in one thread: the controller's matrices are small, so that more threads
only wait for each other, on a busy machine for several times the step itself."""


RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
"""Environment variable of ROS: how far nodes look for others."""
PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""Environment variable of Fast DDS: its settings."""


def node_environment() -> dict[str, str]:
    """Give what to add to this process's environment for nodes that are its children.

    They end with this process, compute in one thread, and open no socket to the network, unless
    ROS_AUTOMATIC_DISCOVERY_RANGE is set to anything but LOCALHOST. Whatever of these the
    environment sets already stays; who names a Fast DDS profile decides alone who hears the nodes.
    """
    added = {k: v for k, v in SINGLE_THREADED_ALGEBRA.items() if k not in os.environ}
    added |= bound_to_this_process()
    if PROFILE not in os.environ:
        closed = os.environ.get(RANGE, "LOCALHOST") == "LOCALHOST"
        profile = "loopback.xml" if closed else "fastdds.xml"
        added[PROFILE] = str(files("gtmr_msgs_py.start") / profile)
        if closed:
            # LOCALHOST itself leaves sockets open at all addresses; here the profile sees to it.
            added[RANGE] = "SYSTEM_DEFAULT"
    return added


def ros_environment(domain_id: int | None = None) -> dict[str, str]:
    """Give the environment of nodes that find each other fast, no other nodes, and end with us.

    What the caller's environment sets already stays, but for ROS_DOMAIN_ID, 0 to 101, if one is
    given: it keeps graphs on one machine apart. See `node_environment`.
    """
    environment = dict(os.environ) | node_environment()
    # Wheels from PyPI leave it unset, and ament_index_python then fails.
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    if domain_id is not None:
        environment["ROS_DOMAIN_ID"] = str(domain_id)
    return environment
