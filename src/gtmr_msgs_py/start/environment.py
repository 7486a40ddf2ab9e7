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
from pathlib import Path

SINGLE_THREADED_ALGEBRA = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}
"""Keeps linear algebra in one thread: the controller's matrices are small, so that more threads
only wait for each other, on a busy machine for several times the step itself."""


def ros_environment(domain_id: int | None = None) -> dict[str, str]:
    """Give the environment for nodes that shall find each other fast and nobody else.

    What the caller's environment sets already stays, but for ROS_DOMAIN_ID, 0 to 101, if one is
    given: it keeps graphs on one machine apart.
    """
    environment = dict(os.environ)
    profile = Path(str(files("gtmr_msgs_py.start") / "fastdds.xml"))
    environment.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # Wheels from PyPI leave it unset, and ament_index_python then fails.
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    for name, value in SINGLE_THREADED_ALGEBRA.items():
        environment.setdefault(name, value)
    if domain_id is not None:
        environment["ROS_DOMAIN_ID"] = str(domain_id)
    return environment
