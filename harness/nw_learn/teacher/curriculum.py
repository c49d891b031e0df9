"""Who trains on what: tasks by shares, levels by success, scenes by failure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_learn.teacher.config import GROUNDS, CourseSettings, TrainingPhase
from nw_learn.teacher.lanes import Lanes

_EASIER = 0.12
"""Share of the episodes that replay a lower level, so that none is forgotten."""
_TOP = 5
"""Who passed the top level goes on anywhere from this one up."""
_COURSE_MEMORY, _SCENE_MEMORY = 0.02, 0.1
"""Weights of the newest episode in running means."""
_FLAT = GROUNDS.index("flat")

Robots = NDArray[np.intp]


class Curriculum:
    """Levels of N robots, and how well things go.

    A robot goes up a level when it reaches all waypoints, and down when it reaches fewer than half.
    Episodes in scenes change no level; scenes that go badly come more often.

    Args:
        count: robots, N.
        settings: from the config.
        lanes: that there are.
        rng: all choices come from it.

    Attributes:
        tasks: (N,) index into `GROUNDS`.
        levels: (N, 5) level of each robot in each task.
        played: (N,) level of the present episode; -1 in a scene.
        courses: (5,) running mean of the share of waypoints reached on random courses.
        places: (S,) the same in each scene.
    """

    def __init__(
        self, count: int, settings: CourseSettings, lanes: Lanes, rng: np.random.Generator
    ) -> None:
        self._lanes, self._rng, self._settings = lanes, rng, settings
        low, high = settings.start
        self.tasks = np.zeros(count, dtype=np.intp)
        self.levels = rng.integers(low, high + 1, (count, len(GROUNDS)))
        self.played = np.full(count, -1)
        self.courses = np.full(len(GROUNDS), 0.5)
        self.places = np.full(len(lanes.scenes), 0.5)
        self._scene_share = 0.0

    def begin(self, phase: TrainingPhase) -> None:
        """Share the robots out among the tasks of a phase; episodes under way go on."""
        ends = np.round(np.cumsum(phase.tasks.of) * len(self.tasks))
        tasks = np.searchsorted(ends, np.arange(len(self.tasks)), side="right")
        self.tasks = np.minimum(tasks, len(GROUNDS) - 1)
        self._scene_share = phase.scenes

    def judge(self, robots: Robots, lanes: Robots, fractions: NDArray[np.float64]) -> None:
        """Take how episodes ended: in which lanes, and which share of the waypoints was reached."""
        top = self._settings.levels - 1
        for robot, lane, fraction in zip(robots, lanes, fractions, strict=True):
            if lane >= self._lanes.random_count:
                scene = lane - self._lanes.random_count
                self.places[scene] += _SCENE_MEMORY * (fraction - self.places[scene])
                continue
            ground = self._lanes.grounds[lane]
            self.courses[ground] += _COURSE_MEMORY * (fraction - self.courses[ground])
            level = self.levels[robot, ground]
            if self.played[robot] != level:
                continue
            if fraction >= 1.0:
                level += 1
            elif fraction < 0.5:
                level = max(level - 1, 0)
            if level > top:
                level = self._rng.integers(min(_TOP, top), top + 1)
            self.levels[robot, ground] = level

    def choose(self, robots: Robots) -> Robots:
        """Return the lanes of the next episodes of some robots."""
        chosen = np.empty(len(robots), dtype=np.intp)
        for index, robot in enumerate(robots):
            chosen[index] = self._choose(int(robot))
        return chosen

    def _choose(self, robot: int) -> int:
        rng, lanes, ground = self._rng, self._lanes, int(self.tasks[robot])
        scenes = np.flatnonzero(lanes.grounds[lanes.random_count :] == ground)
        if ground != _FLAT and len(scenes) and rng.random() < self._scene_share:
            self.played[robot] = -1
            weights = 1.1 - self.places[scenes]
            scene = rng.choice(scenes, p=weights / weights.sum())
            return lanes.random_count + int(scene)
        level = int(self.levels[robot, ground])
        if rng.random() < _EASIER:
            level = int(rng.integers(0, level + 1))
        self.played[robot] = level
        of_level = lanes.of_level(ground, level)
        return int(rng.integers(of_level.start, of_level.stop))

    def figures(self) -> dict[str, float]:
        """Return what the curve shows."""
        figures: dict[str, float] = {}
        grounds = self._lanes.grounds[self._lanes.random_count :]
        means: list[float] = []
        for ground, name in enumerate(GROUNDS):
            robots = self.tasks == ground
            if robots.any():
                figures[f"courses/{name}"] = float(self.courses[ground])
                if ground != _FLAT:
                    figures[f"level/{name}"] = float(self.levels[robots, ground].mean())
            if (grounds == ground).any():
                means.append(float(self.places[grounds == ground].mean()))
                figures[f"scenes/{name}"] = means[-1]
        if means:
            figures["scenes/mean"] = float(np.mean(means))
        return figures

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return everything that changes, by name."""
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}
