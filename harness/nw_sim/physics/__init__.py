"""Simulation: a robot in a scene under MuJoCo."""

from nw_sim.physics.looks import RobotRays
from nw_sim.physics.model import Actuators
from nw_sim.physics.world import World

__all__ = [
    "Actuators",
    "RobotRays",
    "World",
]
