# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""Environment of all tests, set before any ROS library is loaded."""

import os

from gtmr_msgs_py.environment import ros_environment

os.environ.update(ros_environment())
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
