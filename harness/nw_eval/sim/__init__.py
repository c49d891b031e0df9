"""Simulation: a robot in a scene under MuJoCo."""

from nw_eval.sim.looks import RobotRays
from nw_eval.sim.model import Actuators
from nw_eval.sim.world import World

__all__ = [
    "Actuators",
    "RobotRays",
    "World",
]
