"""Starts the node: `ros2 launch coilcal_ros magnet.launch.py calibrations:="['/data/calibration']"`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """The node with its parameters."""
    names = {"calibrations": "['calibration']", "most_A": "0.0", "frame_id": "world"}
    arguments = [DeclareLaunchArgument(name, default_value=value) for name, value in names.items()]
    parameters = {name: LaunchConfiguration(name) for name in names}
    node = Node(
        package="coilcal_ros", executable="magnet", name="magnet", parameters=[parameters], output="screen"
    )
    return LaunchDescription([*arguments, node])
