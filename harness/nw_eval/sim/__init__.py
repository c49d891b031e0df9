"""Simulation: a robot in a scene under MuJoCo, progress along its trail, and when a trial ends."""

from nw_eval.sim.body import RobotRays
from nw_eval.sim.course import Limits, Termination, TrailProgress
from nw_eval.sim.model import Actuators
from nw_eval.sim.world import World

__all__ = [
    "Actuators",
    "Limits",
    "RobotRays",
    "Termination",
    "TrailProgress",
    "World",
]
