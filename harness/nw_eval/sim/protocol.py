"""The two ways to run an episode."""

from nw_eval.words import Protocol

__all__ = ["Protocol"]

# `strict` is the sane evaluation; `neverwhere-2026` is the published one, bug for bug. Every
# difference between them in this room: damping of the free joint and how foot forces are read
# (`world`), which contacts end an episode and what else does (`termination`), and whether the
# reach timer starts again when the robot leaves a waypoint (`trail`).
