"""All lanes of a training: random courses by task and level, and the training scenes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nw_eval.catalogue import get_scene, names
from nw_eval.learn.teacher.config import GROUNDS, CourseSettings
from nw_eval.learn.teacher.courses.draw import draw_course
from nw_eval.learn.teacher.courses.lane import SHAPE, Lane, lane_of
from nw_eval.robots import RobotSpec
from nw_eval.sim.binding import MjModel

_FLAT = GROUNDS.index("flat")
_STREAM = 1
"""Of the seed, from which courses are drawn."""


class Lanes:
    """Lanes by number: of each task those of level 0, 1, ..., then flat ones, then scenes.

    Args:
        settings: from the config.
        robot: a `training_robot`.
        seed: of the training.
        generations: how often each lane was drawn anew before, (L,); None = never.
        say: is told how far it is.

    Attributes:
        scenes: names of the training scenes, in the order of their lanes.
        heights: (L, X, Y) float32, m.
        edges: (L, X, Y) uint8.
        grounds: (L,) indices into `GROUNDS`.
        levels: (L,) level of each random course; the top one for scenes.
        generations: (L,) how often each lane was drawn anew.

    Raises:
        SceneError: a scene does not fit a lane.
    """

    def __init__(
        self,
        settings: CourseSettings,
        robot: RobotSpec,
        seed: int,
        *,
        generations: NDArray[np.int64] | None = None,
        say: Callable[[str], None] | None = None,
    ) -> None:
        self._settings, self._robot, self._seed = settings, robot, seed
        self.scenes = names("train") if settings.scenes is None else settings.scenes
        flat_from = _FLAT * settings.levels * settings.variants
        self.random_count = flat_from + settings.variants
        count = self.random_count + len(self.scenes)
        drawn = np.arange(self.random_count)
        of_scenes = [GROUNDS.index(get_scene(name).task) for name in self.scenes]
        per_ground = settings.levels * settings.variants
        self.grounds = np.concatenate([drawn // per_ground, of_scenes]).astype(np.intp)
        levels = np.where(drawn < flat_from, drawn // settings.variants % settings.levels, 0)
        self.levels = np.concatenate([levels, np.full(len(self.scenes), settings.levels - 1)])
        self.generations = (
            np.zeros(count, dtype=np.int64) if generations is None else generations.copy()
        )
        self.heights = np.zeros((count, *SHAPE), dtype=np.float32)
        self.edges = np.zeros((count, *SHAPE), dtype=np.uint8)
        self.floors = np.zeros(count)
        self.trails: list[NDArray[np.float64]] = []
        self.noises = np.zeros((count, 2))
        self.models: list[MjModel] = []
        for number in range(count):
            if say is not None and number % 100 == 0:
                say(f"{number} of {count} courses")
            lane = self._lane(number)
            self.models.append(lane.model)
            self.trails.append(lane.trail)
            self._fill(number, lane)

    def redraw(self, number: int) -> MjModel:
        """Draw a random course anew, and return its model."""
        self.generations[number] += 1
        lane = self._lane(number)
        self.models[number], self.trails[number] = lane.model, lane.trail
        self._fill(number, lane)
        return lane.model

    def of_level(self, ground: int, level: int) -> slice:
        """Return the numbers of the random courses of a task and a level."""
        variants = self._settings.variants
        first = (ground * self._settings.levels + (0 if ground == _FLAT else level)) * variants
        return slice(first, first + variants)

    def _lane(self, number: int) -> Lane:
        if number >= self.random_count:
            scene = get_scene(self.scenes[number - self.random_count])
        else:
            key = (_STREAM, number, int(self.generations[number]))
            rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=key))
            ground = GROUNDS[self.grounds[number]]
            scene = draw_course(ground, int(self.levels[number]), rng)
        return lane_of(scene, self._robot)

    def _fill(self, number: int, lane: Lane) -> None:
        self.heights[number], self.edges[number] = lane.heights, lane.edges
        self.floors[number], self.noises[number] = lane.floor, lane.noise
