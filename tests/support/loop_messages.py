# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The messages of the control loop, made field by field: what the packed bytes must be."""

import math
from array import array

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, PoseStamped, Vector3
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from gtmr_msgs_py.wire import attitude, stamps


def odometry_message(stamp_ns, x):
    """Of a state [p, eta, v, omega, ...]."""
    msg = Odometry(child_frame_id="base_link")
    msg.header.stamp, msg.header.frame_id = stamps.encode(stamp_ns), "map"
    pose, twist = msg.pose.pose, msg.twist.twist
    pose.position = xyz(Point, x[0:3])
    pose.orientation = attitude.encode(x[3:6])
    twist.linear = xyz(Vector3, attitude.rotation(pose.orientation).T @ x[6:9])
    twist.angular = xyz(Vector3, x[9:12])
    return msg


def rotor_states_message(stamp_ns, xi):
    """Of rotor speeds [Hz]."""
    msg = JointState(name=names(len(xi)), velocity=rad(xi))
    msg.header.stamp = stamps.encode(stamp_ns)
    return msg


def rotor_command_message(stamp_ns, step_ns, xi, u):
    """Of planned rotor speeds [Hz] and accelerations [Hz/s], which end with none."""
    points = [
        JointTrajectoryPoint(velocities=rad(speeds), accelerations=rad(accelerations))
        for speeds, accelerations in zip(xi, [*u, np.zeros(len(xi[0]))], strict=True)
    ]
    for i, point in enumerate(points):
        sec, nanosec = divmod(i * step_ns, 10**9)
        point.time_from_start = Duration(sec=sec, nanosec=nanosec)
    msg = JointTrajectory(joint_names=names(len(xi[0])), points=points)
    msg.header.stamp = stamps.encode(stamp_ns)
    return msg


def path_message(stamp_ns, step_ns, positions, rpy):
    """Of positions [m] and attitudes [rad], the first at the stamp."""
    msg = Path()
    msg.header.stamp, msg.header.frame_id = stamps.encode(stamp_ns), "map"
    for i, (position, angles) in enumerate(zip(positions, rpy, strict=True)):
        pose = PoseStamped()
        pose.header.stamp, pose.header.frame_id = stamps.encode(stamp_ns + i * step_ns), "map"
        pose.pose.position = xyz(Point, position)
        pose.pose.orientation = attitude.encode(angles)
        msg.poses.append(pose)
    return msg


def names(n_rotors):
    return [f"rotor_{i}" for i in range(n_rotors)]


def rad(turns):
    return array("d", (2.0 * math.pi * turn for turn in turns))


def xyz(message, values):
    x, y, z = map(float, values)
    return message(x=x, y=y, z=z)
