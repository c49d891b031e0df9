"""Courses with nothing around them, and one with nothing in the way."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.entry import Course, Entry
from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.scenes.scene import Scene, Vector
from nw_eval.words import Task


@dataclass(frozen=True, kw_only=True)
class Bare:
    """The kind of place that has ground alone."""

    @property
    def indoor(self) -> bool:
        """Nothing keeps the sky out."""
        return False

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build nothing."""


@dataclass(frozen=True, kw_only=True)
class Zigzag:
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

    def build(self, builder: PlaceBuilder) -> None:
        """Build nothing."""


def bare_scene(course: Course, *, task: Task, waypoint_noise: tuple[float, float]) -> Scene:
    """Return a course as a scene, with the very boxes and faces that a built-in one has."""
    entry = Entry(
        name=f"{task}/random",
        title="a random course",
        setting=Bare(),
        course=course,
        light="noon",
        task=task,
        waypoint_noise=waypoint_noise,
    )
    return entry.scene()
