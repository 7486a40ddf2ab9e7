"""The ROS contract: topics, and conversions between arrays and common_interfaces messages.

One module per kind of message, each with ``encode`` and ``decode``; units and frames are
converted there and nowhere else.
"""
