# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""The time of one controller step as std_msgs/Float64."""

from __future__ import annotations

from std_msgs.msg import Float64


def encode(solve_time_s: float) -> Float64:
    """Make the message of a solve time.

    Parameters
    ----------
    solve_time_s : float
        Preparation and feedback together, wall time [s].

    Returns
    -------
    std_msgs.msg.Float64
    """
    return Float64(data=float(solve_time_s))
