"""Does a policy do what it is commanded: ahead, to both sides and in turns, on the flat?

A card whose scales are not the training's often walks all the same, and only follows badly.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from nw_policies.cards import Card
from nw_policies.cards.card import ConstantCommand, TrailFollower
from nw_policies.cards.observations import ProprioObservation
from nw_sim.probe.recording import Rig
from nw_sim.rollout.fault import PolicyFailedError
from nw_sim.sensors.proprio import commanded_speed

_FOLLOWS = 0.6
"""Share of a command that a policy reaches under its own card, and of which it reaches no more
than the inverse. Measured on five policies: 0.63 to 1.08 of every command here; 0.45 to the left
with half of the scale at the hips."""
_WELL = 0.75
"""The same share, above which no other card is worth a try. Two of the five reach all of that."""

_SECONDS = 2.0
_SETTLED = 1.0  # s; until then it gets up to speed.
_SIDEWAYS = 0.5  # m/s
_TURNING = 1.0  # rad/s
_SPEED = 0.8  # m/s ahead while it goes sideways or turns: some policies stand still without.
_LEAST = 0.1  # m/s or rad/s; of less, the sway of the steps is too large a share.
_STILL = 0.1  # Share of a command; who stands sways with less.
_UNITS = ("m/s", "m/s", "rad/s")
_NAMES = ("lin_vel_x", "lin_vel_y", "ang_vel_z")
_WAYS = (("ahead", "backwards"), ("to the left", "to the right"), ("turning left", "turning right"))

Velocity = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A command, of which one axis is looked at."""

    words: str
    velocity: Velocity
    """vx, vy (m/s) and yaw rate (rad/s)."""
    axis: int
    """Which of the three is looked at."""
    is_used: bool
    """Whether trials command it under this card."""
    is_own: bool = False
    """Whether the card's own source commands it, in place of a constant velocity."""

    @property
    def size(self) -> float:
        """Size of the command, m/s or rad/s."""
        return abs(self.velocity[self.axis])

    @property
    def unit(self) -> str:
        """Of the command."""
        return _UNITS[self.axis]


@dataclass(frozen=True, kw_only=True)
class Followed:
    """What became of a command."""

    motion: Motion
    ratio: float
    """Reached over commanded once it had time to get up to speed; 0 if it fell or hit its head or
    trunk before that."""
    fell: bool
    stumbled: bool = False
    """Whether it fell, bumped or leant as no policy does under its own card."""

    @property
    def is_missed(self) -> bool:
        """Whether it is not what a policy does under its own card."""
        return self.fell or not _FOLLOWS <= self.ratio <= 1.0 / _FOLLOWS

    @property
    def is_opposite(self) -> bool:
        """Whether it goes the other way, as no policy does under its own card."""
        return self.ratio <= -_FOLLOWS

    @property
    def is_weak(self) -> bool:
        """Whether another card may do better."""
        return self.stumbled or self.fell or not _WELL <= self.ratio <= 1.0 / _WELL

    @property
    def error(self) -> float:
        """How far it is from its command, as a share of it; at most 1, and 1 if it stumbled."""
        return 1.0 if self.fell or self.stumbled else min(1.0, abs(1.0 - self.ratio))

    @property
    def reached(self) -> float:
        """What became of the command, m/s or rad/s."""
        return self.ratio * self.motion.size

    @property
    def words(self) -> tuple[str, str, str]:
        """The direction, what was commanded, what was reached."""
        motion, unit = self.motion, self.motion.unit
        return motion.words, f"{motion.size:g} {unit}", f"{self.reached:z.2f} {unit}"


def motions(card: Card) -> list[Motion]:
    """Return the commands to try, at least 0.1 m/s or rad/s each; none if it sees no command.

    A constant command is tried as it is. Beside it, and for all others: ahead at the card's speed;
    sideways and in turns, walking ahead with it. What no trial commands is no faster than the
    training commanded, where the card says that (`trained_speeds`), and is left out below 0.1.
    """
    ranges = [card.trained_speeds.get(name) for name in _NAMES]
    return [kept for one in _all_motions(card) if (kept := _within(one, ranges)) is not None]


def _within(motion: Motion, ranges: Sequence[tuple[float, float] | None]) -> Motion | None:
    """Return a motion at a speed that the training commanded; None where there is none to see."""
    limits, value = ranges[motion.axis], motion.velocity[motion.axis]
    if motion.is_used or limits is None:
        return motion
    value = min(max(value, limits[0]), limits[1])
    if abs(value) < _LEAST or value * motion.velocity[motion.axis] < 0.0:
        return None
    velocity = [*motion.velocity]
    velocity[motion.axis] = value
    return replace(motion, velocity=(velocity[0], velocity[1], velocity[2]))


def _all_motions(card: Card) -> list[Motion]:
    command = card.command
    if "command" not in _terms(card):
        return []
    if isinstance(command, ConstantCommand):
        own = [
            _motion(command.velocity, axis, is_used=True, more=" (on the card)")
            for axis, value in enumerate(command.velocity)
            if abs(value) >= _LEAST
        ]
        others = _all_ways(command.velocity[0], 0.0, is_used=False)
        return [*own, *(other for other in others if other.velocity != command.velocity)]
    turning = 0.0
    if isinstance(command, TrailFollower):
        turning = min(command.yaw_limit, command.yaw_gain * math.pi)
    return _all_ways(command.speed, turning, is_used=True)


def own_way(card: Card) -> list[Motion]:
    """Return what a policy does of itself, commanded or not: it goes ahead at the card's speed."""
    speed = commanded_speed(card.command)
    if abs(speed) < _LEAST or card.reference is not None:
        return []  # What tracks a motion goes where that goes.
    text = "on its way"
    return [Motion(words=text, velocity=(speed, 0.0, 0.0), axis=0, is_used=False, is_own=True)]


def finds_its_way(card: Card) -> bool:
    """Whether a policy that sees no command sees where to go, or how fast."""
    return not _terms(card).isdisjoint({"delta_yaw", "speed"})


def _terms(card: Card) -> set[str]:
    return {
        term.term
        for observation in card.observations.values()
        if isinstance(observation, ProprioObservation)
        for term in observation.frame_terms
    }


def _all_ways(speed: float, turning: float, *, is_used: bool) -> list[Motion]:
    """Return all five, at usual speeds where these are too small to be used."""
    walks, turns = is_used and speed >= _LEAST, is_used and turning >= _LEAST
    ahead = speed if speed >= _LEAST else _SPEED
    turning = min(turning, _TURNING) if turns else _TURNING
    walking = min(ahead, _SPEED)
    return [
        _motion((ahead, 0.0, 0.0), 0, is_used=walks),
        _motion((walking, _SIDEWAYS, 0.0), 1, is_used=False),
        _motion((walking, -_SIDEWAYS, 0.0), 1, is_used=False),
        _motion((walking, 0.0, turning), 2, is_used=turns),
        _motion((walking, 0.0, -turning), 2, is_used=turns),
    ]


def _motion(velocity: Velocity, axis: int, *, is_used: bool, more: str = "") -> Motion:
    words = _WAYS[axis][velocity[axis] < 0.0] + more
    return Motion(words=words, velocity=velocity, axis=axis, is_used=is_used)


def follow(
    rig: Rig, card: Card, tried: Sequence[Motion], *, level: float = math.inf
) -> Iterator[Followed]:
    """Command each motion for two seconds under a card, and yield what becomes of it.

    Args:
        rig: of the policy.
        card: under which it is commanded.
        tried: what is commanded.
        level: roll or pitch that ends a recording, rad.

    Raises:
        NwEvalError: it cannot be run.
    """
    for (velocity, is_own), same in groupby(tried, key=lambda one: (one.velocity, one.is_own)):
        constant = ConstantCommand(source="constant", velocity=velocity)
        commanded = card if is_own else card.model_copy(update={"command": constant})
        try:
            recording = rig.record(commanded, seconds=_SECONDS, level=level)
        except PolicyFailedError as error:
            if error.kind not in {"action", "diverged"}:
                raise
            # It ran away, as some do once the robot lies on its back.
            yield from (Followed(motion=one, ratio=0.0, fell=False, stumbled=True) for one in same)
            continue
        settled = recording.velocity[round(_SETTLED / recording.period) :]
        reached = settled.mean(axis=0) if len(settled) else np.zeros(3)
        for motion in same:
            yield Followed(
                motion=motion,
                ratio=float(reached[motion.axis]) / velocity[motion.axis],
                fell=recording.outcome == "fell",
                stumbled=recording.stumbles,
            )


def stands_still(followed: Sequence[Followed]) -> bool:
    """Whether a policy moves under none of its commands, and stays on its feet."""
    return bool(followed) and all(abs(one.ratio) < _STILL and not one.fell for one in followed)


def deviation(followed: Sequence[Followed]) -> float:
    """Return how far a policy is from its commands, 0 to 1: the root mean square of `error`.

    That of the worst command alone would tell nothing where a right card misses one as well; the
    mean would hide one that is missed among four that are not.
    """
    return math.sqrt(sum(one.error**2 for one in followed) / len(followed))
