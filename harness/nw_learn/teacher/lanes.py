"""All lanes of a training: random courses by task and level, and the training scenes.

A lane is a scene as the physics and the sensors of a training need it. Random courses come from the
generators of the built-in scenes with random figures, harder by level. Nothing stands around them,
and on flat ground nothing is in the way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.protocol import STRICT
from nw_base.words import Task
from nw_learn.teacher.config import GROUNDS, CourseSettings, Ground
from nw_places.entry import Course, Entry
from nw_places.gaps import Gaps
from nw_places.hurdles import Hurdles
from nw_places.places.builder import SceneBuilder
from nw_places.ramps import Boards, Humps
from nw_places.stairs import Stairs
from nw_scenes.mesh import rotation_matrix
from nw_scenes.rays import RayScene
from nw_scenes.robots import RobotSpec
from nw_scenes.scene import Box, Scene, Vector
from nw_sim.catalogue import get_scene, names
from nw_sim.physics.model import Actuators, Model, compile_model

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
        waypoint_noise=waypoint_noise,
    )
    return entry.scene()


_FLAT = GROUNDS.index("flat")
_STREAM = 1
"""Of the seed, from which courses are drawn."""

CELL = 0.025
"""Of a lane's grid of heights, metres."""
ORIGIN = (-1.5, -2.5)
SHAPE = (480, 200)
"""Cells ahead and across: 12 by 5 m. Points beyond have the height of the nearest cell."""
SOLIDS = 28
"""Boxes of every lane, so that all of them make models of one size."""
WAYPOINTS = 8
_REACH = 1.0
"""Metres from the course within which solids can be touched; a robot further away is lost."""
_EDGE = 0.05
"""Metres: that a step is high at least, and that a foot is near it at most."""
_NOWHERE = -50.0


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
        self.models: list[Model] = []
        for number in range(count):
            if say is not None and number % 100 == 0:
                say(f"{number} of {count} courses")
            lane = self._lane(number)
            self.models.append(lane.model)
            self.trails.append(lane.trail)
            self._fill(number, lane)

    def redraw(self, number: int) -> Model:
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Lane:
    """One scene to train in.

    Attributes:
        model: robot and solids; every lane's has the same sizes.
        heights: (X, Y) float32 of the ground in the world, m, at the middles of the cells.
        edges: (X, Y) uint8, 1 within 5 cm of an edge across the course.
        trail: (K, 2) waypoints, m.
        noise: half widths by which an episode moves them, (2,) m.
        floor: height of the lowest ground, m.
    """

    model: Model
    heights: NDArray[np.float32]
    edges: NDArray[np.uint8]
    trail: NDArray[np.float64]
    noise: NDArray[np.float64]
    floor: float


def lane_of(scene: Scene, robot: RobotSpec) -> Lane:
    """Return the lane of a scene of boxes.

    Args:
        scene: its spawn is at the origin and looks along x, as those of all built-in scenes.
        robot: a `training_robot`.

    Raises:
        SceneError: it has other solids than boxes, too many of them, or too many waypoints.
    """
    corners = np.vstack([np.zeros((1, 2)), scene.trail[:, :2]])
    boxes = [solid for solid in scene.solids if isinstance(solid, Box)]
    between = np.linspace(corners[:-1], corners[1:], 30).reshape(-1, 2)
    solids = [box for box in boxes if _is_near(box, between)]
    if len(boxes) < len(scene.solids) or len(solids) > SOLIDS or len(scene.trail) > WAYPOINTS:
        raise SceneError(
            f"{scene.name} has {len(solids)} boxes near its {len(scene.trail)} waypoints, "
            f"{SOLIDS} and {WAYPOINTS} fit, and no other solids",
            fix="remove it from `courses.scenes`",
        )
    parked = [
        Box(center=(0.0, 3.0 * number, _NOWHERE), half_size=(0.1, 0.1, 0.1))
        for number in range(SOLIDS - len(solids))
    ]
    model = compile_model(
        robot,
        replace(scene, solids=(*solids, *parked)),
        protocol=STRICT,
        actuators=Actuators.of(robot),
        friction=None,
        payload=0.0,
        timestep=0.005,
    )
    heights = _heights(scene)
    return Lane(
        model=model,
        heights=heights,
        edges=_edges(heights),
        trail=scene.trail[:, :2].copy(),
        noise=np.array(scene.waypoint_noise),
        floor=scene.ground.z,
    )


def _is_near(box: Box, points: NDArray[np.float64]) -> bool:
    """Say whether a box, seen from above, is within reach of any point (P, 2) of the course."""
    half = np.abs(rotation_matrix(box.quat)) @ np.array(box.half_size)
    # Along the course every few centimetres: how far outside the box's outline each point is.
    outside = np.maximum(np.abs(points - np.array(box.center[:2])) - half[:2], 0.0)
    return bool((np.hypot(*outside.T) < _REACH).any())


def _heights(scene: Scene) -> NDArray[np.float32]:
    axes = [start + CELL * (np.arange(n) + 0.5) for start, n in zip(ORIGIN, SHAPE, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    heights = RayScene(scene.mesh()).height(points)
    return np.maximum(heights, scene.ground.z - 1.0).astype(np.float32).reshape(SHAPE)


def _edges(heights: NDArray[np.float32]) -> NDArray[np.uint8]:
    steps = np.abs(np.diff(heights, axis=0)) > _EDGE
    edges = np.zeros(heights.shape, dtype=np.uint8)
    reach = round(_EDGE / CELL)
    for shift in range(-reach, reach):
        low, high = max(0, -shift), min(len(steps), len(edges) - 1 - shift)
        edges[low + shift + 1 : high + shift + 1] |= steps[low:high]
    return edges
