"""Simulation: a robot in a scene under MuJoCo, progress along its trail, and when a trial ends."""

from nw_eval.sim.actuators import Actuators
from nw_eval.sim.protocol import Protocol
from nw_eval.sim.rays import RobotRays
from nw_eval.sim.termination import Limits, Termination
from nw_eval.sim.trail import TrailProgress
from nw_eval.sim.world import World

__all__ = [
    "Actuators",
    "Limits",
    "Protocol",
    "RobotRays",
    "Termination",
    "TrailProgress",
    "World",
]
