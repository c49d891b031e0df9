"""Simulation: a robot in a scene under MuJoCo, progress along its trail, and when a trial ends."""

from nw_eval.sim.actuators import Actuators
from nw_eval.sim.readings.rays import RobotRays
from nw_eval.sim.termination import Limits, Termination
from nw_eval.sim.trail import TrailProgress
from nw_eval.sim.world import World

__all__ = [
    "Actuators",
    "Limits",
    "RobotRays",
    "Termination",
    "TrailProgress",
    "World",
]
