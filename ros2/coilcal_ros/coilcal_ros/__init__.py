"""A calibrated magnet as a ROS 2 node."""
