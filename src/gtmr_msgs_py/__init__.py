# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""The ROS contract: topics, and conversions between arrays and common_interfaces messages.

One module per kind of message, each with ``encode`` and ``decode``; units and frames are
converted there and nowhere else.
"""
