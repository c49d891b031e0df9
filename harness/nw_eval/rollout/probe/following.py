"""Does a policy do what it is commanded: ahead, to both sides and in turns, on the flat?

A card whose scales are not the training's often walks all the same, and only follows badly.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from nw_eval.policies import Card
from nw_eval.policies.card import ConstantCommand, TrailFollower
from nw_eval.policies.observations import ProprioObservation
from nw_eval.rollout.probe.recording import Stage

_FOLLOWS = 0.6
"""Share of a command that a policy reaches under its own card, and of which it reaches no more
than the inverse. Measured on two policies: 0.81 to 1.05 of every command here; 0.45 to the left
with half of the scale at the hips."""

_SECONDS = 2.0
_SETTLED = 1.0  # s; until then it gets up to speed.
_SIDEWAYS = 0.5  # m/s
_TURNING = 1.0  # rad/s
_SPEED = 0.8  # m/s ahead while it goes sideways or turns: some policies stand still without.
_UNITS = ("m/s", "m/s", "rad/s")


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A command that goes one way; sideways and in turns, the robot walks ahead with it."""

    words: str
    velocity: tuple[float, float, float]
    """vx, vy (m/s) and yaw rate (rad/s)."""
    axis: int
    """Which of the three is looked at."""
    is_used: bool
    """Whether trials command it under this card."""

    @property
    def asked(self) -> float:
        """Size of the command, m/s or rad/s."""
        return abs(self.velocity[self.axis])


@dataclass(frozen=True, kw_only=True)
class Followed:
    """What became of a command."""

    motion: Motion
    ratio: float
    """Reached over commanded once it had time to get up to speed; 0 if it fell before that."""
    fell: bool

    @property
    def is_missed(self) -> bool:
        """Whether it is not what a policy does under its own card."""
        return self.fell or not _FOLLOWS <= self.ratio <= 1.0 / _FOLLOWS

    @property
    def words(self) -> tuple[str, str, str]:
        """The direction, what was commanded, what was reached."""
        unit = _UNITS[self.motion.axis]
        reached = f"{self.ratio * self.motion.asked:.2f} {unit}" + (", fell" if self.fell else "")
        return self.motion.words, f"{self.motion.asked:g} {unit}", reached


def motions(card: Card) -> list[Motion]:
    """Return the commands to try; none if the policy sees no velocity command."""
    terms = {
        term.term
        for observation in card.observations.values()
        if isinstance(observation, ProprioObservation)
        for term in observation.frame_terms
    }
    command, turning = card.command, _TURNING
    if "command" not in terms:
        return []
    if isinstance(command, ConstantCommand):
        used = [value != 0 for value in command.velocity]
        ahead = max(command.velocity[0], 0.0) or _SPEED
    else:
        used = [command.speed > 0, False, isinstance(command, TrailFollower)]
        ahead = command.speed or _SPEED
    if isinstance(command, TrailFollower):
        turning = min(_TURNING, command.yaw_limit)
    walking = min(ahead, _SPEED)
    return [
        Motion(words=words, velocity=velocity, axis=axis, is_used=used[axis])
        for words, velocity, axis in (
            ("ahead", (ahead, 0.0, 0.0), 0),
            ("to the left", (walking, _SIDEWAYS, 0.0), 1),
            ("to the right", (walking, -_SIDEWAYS, 0.0), 1),
            ("turning left", (walking, 0.0, turning), 2),
            ("turning right", (walking, 0.0, -turning), 2),
        )
    ]


def follow(stage: Stage, card: Card, tried: Sequence[Motion]) -> Iterator[Followed]:
    """Command each motion for two seconds under a card, and yield what becomes of it.

    Raises:
        NwEvalError: it cannot be run.
    """
    for motion in tried:
        command = ConstantCommand(source="constant", velocity=motion.velocity)
        made = stage.record(card.model_copy(update={"command": command}), seconds=_SECONDS)
        settled = made.velocity[round(_SETTLED / made.period) :, motion.axis]
        reached = float(np.mean(settled)) if settled.size else 0.0
        ratio = reached / motion.velocity[motion.axis]
        yield Followed(motion=motion, ratio=ratio, fell=made.outcome == "fell")


def deviation(followed: Sequence[Followed]) -> float:
    """Return how far the worst one is from its command, as a share of it; 1 more if it fell."""
    return max(abs(1.0 - one.ratio) + one.fell for one in followed)
