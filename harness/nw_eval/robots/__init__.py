"""Robots: one frozen specification each, with MJCF of our own written from published figures."""

from nw_eval.robots.catalogue import get_robot, robot_names
from nw_eval.robots.spec import CameraMount, RobotSpec, Shape

__all__ = ["CameraMount", "RobotSpec", "Shape", "get_robot", "robot_names"]
