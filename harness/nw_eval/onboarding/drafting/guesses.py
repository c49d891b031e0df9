"""Which terms and scans a vector of an unknown policy may be made of."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from nw_eval.onboarding.drafting.frames import Frame, frames_of


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


def frames_before_a_scan(size: int) -> tuple[tuple[tuple[Frame, int], ...], ScanGuess | None]:
    """Return known frames that make `size` numbers together with a known grid after them.

    Frames of those who measure the grid come first.
    """
    for scan in SCANS:
        if frames := frames_of(size - scan.size):
            return tuple(sorted(frames, key=lambda fit: scan.source not in fit[0].source)), scan
    return (), None
