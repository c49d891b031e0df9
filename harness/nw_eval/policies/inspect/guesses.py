"""Which terms and scans a vector of an unknown policy may be made of."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

_LEGS = ("FL", "FR", "RL", "RR")
_KINDS = ("hip", "thigh", "calf")
LEG_BY_LEG = tuple(f"{leg}_{kind}" for leg in _LEGS for kind in _KINDS)
"""Joints of Unitree's robots in Isaac Gym, which sorts their names."""
TYPE_BY_TYPE = tuple(f"{leg}_{kind}" for kind in _KINDS for leg in _LEGS)
"""The same in Isaac Lab: hips of all legs first."""
_VELOCITY_SCALES = "[2.0, 2.0, 0.25]"


@dataclass(frozen=True, kw_only=True)
class FrameGuess:
    """Terms of one frame, as a card writes them, and who lays them out so."""

    source: str
    terms: tuple[str, ...]
    size: int
    layout: str | None = None
    """A published layout that stands for the terms."""
    joints: tuple[str, ...] = ()
    """The order of joints there; empty where it is the robots' own."""


@dataclass(frozen=True, kw_only=True)
class ScanGuess:
    """A grid of heights, and who measures it so."""

    source: str
    x: int
    """Points ahead."""
    y: int
    """Points to the left."""

    @property
    def size(self) -> int:
        """Points of the grid."""
        return self.x * self.y


ISAAC_LAB = "Isaac Lab"
PARKOUR = ScanGuess(source="extreme-parkour", x=12, y=11)
SCANS: tuple[ScanGuess, ...] = (
    ScanGuess(source=ISAAC_LAB, x=17, y=11),
    PARKOUR,
    ScanGuess(source=ISAAC_LAB, x=21, y=11),
)


FRAMES: tuple[FrameGuess, ...] = (
    FrameGuess(source="extreme-parkour, LucidSim", terms=(), size=53, layout="parkour53"),
    FrameGuess(
        source="MuJoCo Playground, mjlab",
        terms=("lin_vel", "ang_vel", "gravity", "joint_pos", "joint_vel", "last_output", "command"),
        size=48,
    ),
    FrameGuess(
        source="legged_gym",
        joints=LEG_BY_LEG,
        terms=(
            "{term: lin_vel, scale: 2.0}",
            "{term: ang_vel, scale: 0.25}",
            "gravity",
            f"{{term: command, scale: {_VELOCITY_SCALES}}}",
            "joint_pos",
            "{term: joint_vel, scale: 0.05}",
            "last_output",
        ),
        size=48,
    ),
    FrameGuess(
        source="Isaac Lab",
        joints=TYPE_BY_TYPE,
        terms=("lin_vel", "ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_output"),
        size=48,
    ),
    FrameGuess(
        source="HIMLoco, rl_sar",
        joints=LEG_BY_LEG,
        terms=(
            f"{{term: command, scale: {_VELOCITY_SCALES}}}",
            "{term: ang_vel, scale: 0.25}",
            "gravity",
            "joint_pos",
            "{term: joint_vel, scale: 0.05}",
            "last_output",
        ),
        size=45,
    ),
    FrameGuess(
        source="Isaac Lab without linear velocity",
        joints=TYPE_BY_TYPE,
        terms=("ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_output"),
        size=45,
    ),
)

TERM_OF: dict[str, tuple[str, int]] = {
    "base_lin_vel": ("lin_vel", 3),
    "base_ang_vel": ("ang_vel", 3),
    "projected_gravity": ("gravity", 3),
    "velocity_commands": ("command", 3),
    "velocity_command": ("command", 3),
    "commands": ("command", 3),
    "command": ("command", 3),
    "twist": ("command", 3),
    "joint_pos": ("joint_pos", 12),
    "joint_pos_rel": ("joint_pos", 12),
    "dof_pos": ("joint_pos", 12),
    "joint_vel": ("joint_vel", 12),
    "joint_vel_rel": ("joint_vel", 12),
    "dof_vel": ("joint_vel", 12),
    "actions": ("last_output", 12),
    "action": ("last_output", 12),
    "last_action": ("last_output", 12),
    "last_actions": ("last_output", 12),
    "prev_actions": ("last_output", 12),
}
"""Names that mjlab and Isaac Lab give to observation terms, with our term and its size."""


_SCAN = re.compile(r"scan|height_?map|elevation|^(measured_|terrain_)?heights$", re.IGNORECASE)
_NO_SCAN = re.compile(r"foot|feet|lidar|laser", re.IGNORECASE)


def is_scan(name: str) -> bool:
    """Return whether an input or a term of this name holds heights of the ground."""
    return bool(_SCAN.search(name)) and not _NO_SCAN.search(name)


def scan_of(size: int) -> ScanGuess | None:
    """Return the known grid of `size` points, or one of similar sides; None where there is none."""
    for scan in SCANS:
        if scan.size == size:
            return scan
    sides = [(size // y, y) for y in range(1, 501) if size % y == 0 and 1 <= size // y <= 500]
    if not sides:
        return None
    x, y = min(sides, key=lambda xy: abs(math.log(xy[0] / xy[1] / 1.5)))
    return ScanGuess(source="a guess", x=x, y=y)


def frames_of(size: int) -> tuple[tuple[FrameGuess, int], ...]:
    """Return known frames that make a vector of `size` numbers, with how many of them it takes.

    Fewer frames come first; among those, the order of `FRAMES`.
    """
    fits = [(frame, size // frame.size) for frame in FRAMES if size % frame.size == 0]
    return tuple(sorted((fit for fit in fits if 1 <= fit[1] <= 20), key=lambda fit: fit[1]))


def frames_before_a_scan(size: int) -> tuple[tuple[tuple[FrameGuess, int], ...], ScanGuess | None]:
    """Return known frames that make `size` numbers together with a known grid after them.

    Frames of those who measure the grid come first.
    """
    for scan in SCANS:
        if frames := frames_of(size - scan.size):
            return tuple(sorted(frames, key=lambda fit: scan.source not in fit[0].source)), scan
    return (), None
