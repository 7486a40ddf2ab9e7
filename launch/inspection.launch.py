"""Simulator, controller and monitor together: `ros2 launch gtmr inspection.launch.py`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from gtmr_msgs_py.environment import SINGLE_THREADED_ALGEBRA

ARGUMENTS = {
    "mode": ("robust", "Controller mode: nominal or robust; may be changed in flight"),
    "vehicle": ("paper", "Name of a preset, or path of a .yaml file"),
    "seed": ("0", "Seed of the gusts, and of zeta where it is sampled"),
    "sample_zeta": ("false", "Draw the true mismatch and wind from the uncertainty set"),
    "lockstep": ("false", "Wait for the command of every odometry: the same flight every time"),
    "real_time_factor": ("1.0", "Simulated per wall time; 0 is as fast as possible, in lockstep"),
    "duration_s": ("0.0", "When the flight is over and everything ends [s]; 0 is never"),
    "bag": ("", "New folder to record the flight into; empty for no recording"),
}
"""Names, defaults and meanings of the launch arguments."""


def generate_launch_description() -> LaunchDescription:
    def value(name: str, kind: type) -> ParameterValue:
        return ParameterValue(LaunchConfiguration(name), value_type=kind)

    # A flight that is recorded waits for the recorder.
    recorders = ParameterValue(
        PythonExpression(["1 if '", LaunchConfiguration("bag"), "' else 0"]), value_type=int
    )
    sim = Node(
        package="gtmr",
        executable="sim",
        parameters=[
            {
                "vehicle": value("vehicle", str),
                "seed": value("seed", int),
                "sample_zeta": value("sample_zeta", bool),
                "lockstep": value("lockstep", bool),
                "real_time_factor": value("real_time_factor", float),
                "duration_s": value("duration_s", float),
                "recorders": recorders,
            }
        ],
        output="screen",
        on_exit=Shutdown(),
    )
    nmpc = Node(
        package="gtmr",
        executable="nmpc",
        parameters=[
            {
                "vehicle": value("vehicle", str),
                "mode": value("mode", str),
                "recorders": recorders,
            }
        ],
        output="screen",
        additional_env=SINGLE_THREADED_ALGEBRA,
    )
    monitor = Node(
        package="gtmr",
        executable="monitor",
        parameters=[{"bag": value("bag", str)}],
        output="screen",
    )
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, sim, nmpc, monitor])
