"""Which terms a vector of an unknown policy may be made of."""

from __future__ import annotations

from dataclasses import dataclass

_VELOCITY_SCALES = "[2.0, 2.0, 0.25]"


@dataclass(frozen=True, kw_only=True)
class FrameGuess:
    """Terms of one frame, as a card writes them, and who lays them out so."""

    source: str
    terms: tuple[str, ...]
    size: int
    layout: str | None = None
    """A published layout that stands for the terms."""


FRAMES: tuple[FrameGuess, ...] = (
    FrameGuess(source="extreme-parkour, LucidSim", terms=(), size=53, layout="parkour53"),
    FrameGuess(
        source="MuJoCo Playground, mjlab",
        terms=("lin_vel", "ang_vel", "gravity", "joint_pos", "joint_vel", "last_output", "command"),
        size=48,
    ),
    FrameGuess(
        source="legged_gym",
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
        terms=("lin_vel", "ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_output"),
        size=48,
    ),
    FrameGuess(
        source="HIMLoco, rl_sar",
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


def frames_of(size: int) -> tuple[tuple[FrameGuess, int], ...]:
    """Return known frames that make a vector of `size` numbers, with how many of them it takes.

    Fewer frames come first; among those, the order of `FRAMES`.
    """
    fits = [(frame, size // frame.size) for frame in FRAMES if size % frame.size == 0]
    return tuple(sorted((fit for fit in fits if 1 <= fit[1] <= 20), key=lambda fit: fit[1]))
