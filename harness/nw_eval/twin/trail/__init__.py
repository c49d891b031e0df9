"""A trail through a place that was photographed on a walk, proposed for a person to agree with.

way.py        where one walked, from the cameras
ground.py     the height of the ground along it, and how it leans
stretches.py  what is level, what slopes, and where there is an edge
features.py   hurdles, gaps, slopes, boards and stairs in that
propose.py    waypoints, spawn and task
"""

from nw_eval.twin.trail.features import TrailFeature
from nw_eval.twin.trail.propose import FLOOR, TrailProposal, propose_trail

__all__ = ["FLOOR", "TrailFeature", "TrailProposal", "propose_trail"]
