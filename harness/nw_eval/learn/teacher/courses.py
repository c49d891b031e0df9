"""Random courses: the generators of the built-in scenes with random figures, harder by level.

Nothing stands around them, and on flat ground nothing is in the way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nw_eval.built_in.entry import Course, Entry
from nw_eval.built_in.gaps import Gaps
from nw_eval.built_in.hurdles import Hurdles
from nw_eval.built_in.places.builder import SceneBuilder
from nw_eval.built_in.ramps import Boards, Humps
from nw_eval.built_in.stairs import Stairs
from nw_eval.learn.teacher.config import Ground
from nw_eval.scenes.scene import Scene, Vector
from nw_eval.words import Task

Random = np.random.Generator

_NOISE, _NARROW = (0.0, 0.1), (0.0, 0.05)  # Of waypoints, as the built-in scenes have it, m.


def draw_course(ground: Ground, level: int, rng: Random) -> Scene:
    """Draw one course.

    Args:
        ground: what it asks for.
        level: 0 and up; flat ground has none.
        rng: all figures come from it.
    """
    return _DRAW[ground](level, rng)


def _several(rng: Random, count: int, low: float, high: float) -> tuple[float, ...]:
    return tuple(float(value) for value in rng.uniform(low, high, count))


def _hurdles(level: int, rng: Random) -> Scene:
    height, count = 0.04 + 0.032 * level, int(rng.integers(2, 4))
    heights = tuple(max(0.03, height * factor) for factor in _several(rng, count, 0.85, 1.05))
    course = Hurdles(
        heights=heights,
        gaps=(float(rng.uniform(1.3, 1.9)), *_several(rng, count - 1, 1.5, 2.1)),
        length=float(rng.uniform(0.26, 0.46)),
        width=float(rng.uniform(1.2, 2.4)),
        shift=_several(rng, count, -0.1, 0.1),
        finish=float(rng.uniform(1.4, 1.9)),
    )
    return _bare_scene(course, task="hurdles", waypoint_noise=_NOISE)


def _gaps(level: int, rng: Random) -> Scene:
    gap, count = 0.08 + 0.05 * level, int(rng.integers(3, 5))
    course = Gaps(
        gaps=tuple(gap * factor for factor in _several(rng, count, 0.88, 1.05)),
        edge=float(rng.uniform(1.0, 1.6)),
        length=float(rng.uniform(0.9, 1.2)),
        width=float(rng.uniform(0.9, 1.1)),
        shift=_several(rng, count - 1, -0.08, 0.08),
        thickness=float(rng.uniform(0.15, 0.25)) if rng.random() < 0.3 else None,
        last="floor" if rng.random() < 0.3 else "platform",
    )
    return _bare_scene(course, task="gaps", waypoint_noise=_NOISE)


def _ramps(level: int, rng: Random) -> Scene:
    return _humps(level, rng) if rng.random() < 0.5 else _boards(level, rng)


def _humps(level: int, rng: Random) -> Scene:
    angle, count = 4.0 + 2.6 * level, int(rng.integers(1, 3))
    angles = tuple(angle * factor for factor in _several(rng, count, 0.9, 1.05))
    course = Humps(
        angles=angles,
        # No deck higher than three quarters of a metre.
        lengths=tuple(
            min(length, 0.75 / math.sin(math.radians(degrees)))
            for length, degrees in zip(_several(rng, count, 0.8, 1.5), angles, strict=True)
        ),
        decks=_several(rng, count, 0.4, 0.8),
        first=float(rng.uniform(1.1, 1.6)),
        apart=float(rng.uniform(0.5, 0.9)),
        width=float(rng.uniform(0.8, 1.2)),
        shift=_several(rng, count, -0.12, 0.12),
    )
    return _bare_scene(course, task="ramps", waypoint_noise=_NOISE)


def _boards(level: int, rng: Random) -> Scene:
    angle = 4.0 + 2.2 * level
    course = Boards(
        angles=tuple(angle * factor for factor in _several(rng, 4, 0.88, 1.08)),
        first=float(rng.uniform(1.0, 1.5)),
        length=float(rng.uniform(0.7, 1.0)),
        width=float(rng.uniform(0.8, 0.95)),
        offset=float(rng.uniform(0.1, 0.32)),
        gap=float(rng.uniform(0.05, 0.25)),
        side=1 if rng.random() < 0.5 else -1,
    )
    return _bare_scene(course, task="ramps", waypoint_noise=_NARROW)


def _stairs(level: int, rng: Random) -> Scene:
    rise, count = 0.03 + 0.02 * level, int(rng.integers(5, 9))
    curved = rng.random() < 0.25
    course = Stairs(
        rises=tuple(rise * factor for factor in _several(rng, count, 0.92, 1.05)),
        depth=float(rng.uniform(0.27, 0.36)),
        first=float(rng.uniform(1.2, 1.8)),
        width=float(rng.uniform(1.2, 2.4)),
        turn=float(rng.uniform(-0.15, 0.15)) if curved else 0.0,
        open_risers=not curved and rng.random() < 0.25,
        sides="walls" if not curved and rng.random() < 0.25 else "none",
    )
    return _bare_scene(course, task="stairs", waypoint_noise=_NOISE)


def _flat(_level: int, rng: Random) -> Scene:
    points: list[tuple[float, float]] = []
    x, y = 0.0, 0.0
    for _ in range(5):
        x += float(rng.uniform(0.8, 1.4))
        y = float(np.clip(y + rng.uniform(-0.7, 0.7), -1.2, 1.2))
        points.append((x, y))
    return _bare_scene(_Zigzag(points=tuple(points)), task="hurdles", waypoint_noise=_NOISE)


_DRAW: dict[Ground, Callable[[int, Random], Scene]] = {
    "hurdles": _hurdles,
    "gaps": _gaps,
    "ramps": _ramps,
    "stairs": _stairs,
    "flat": _flat,
}


@dataclass(frozen=True, kw_only=True)
class _Bare:
    """The kind of place that has ground alone."""

    @property
    def indoor(self) -> bool:
        """Nothing keeps the sky out."""
        return False

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build nothing."""


@dataclass(frozen=True, kw_only=True)
class _Zigzag:
    """Waypoints on flat ground.

    Attributes:
        points: x and y of each, metres.
    """

    points: tuple[tuple[float, float], ...]

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return 0.0

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints."""
        return tuple((x, y, 0.0) for x, y in self.points)

    def build(self, builder: SceneBuilder) -> None:
        """Build nothing."""


def _bare_scene(course: Course, *, task: Task, waypoint_noise: tuple[float, float]) -> Scene:
    """Return a course as a scene, with the very boxes and faces that a built-in one has."""
    entry = Entry(
        name=f"{task}/random",
        title="a random course",
        setting=_Bare(),
        course=course,
        light="noon",
        task=task,
        waypoint_noise=waypoint_noise,
    )
    return entry.scene()
