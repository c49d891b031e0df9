"""What a scene asks of legs along its course, and whether a robot's are long enough for it.

Steps and gaps are measured on what collides, against the length of the robot's legs; the room
between walls against its width. These are rules of thumb: they say what no policy could do, not
what one can.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from nw_scenes.finding import SceneFinding
from nw_scenes.robots import RobotSpec
from nw_scenes.scene import Scene
from nw_sim.physics.batch import solid_distances
from nw_sim.survey.course import course_samples, flat_world, stance_of

Values = NDArray[np.float64]

LONGEST_STEP = 1.0
"""Height of a step, in lengths of a leg, beyond which no robot gets up or down."""
LONGEST_GAP = 2.0
"""Length of a gap, in lengths of a leg, beyond which none gets over it."""
WALKED = 0.5
"""Share of the length of a leg up to which a step or a gap asks for no climb and no leap."""

_SPACING = 0.02  # m between samples along the course
_SIDES = (-0.1, 0.0, 0.1)  # m beside it
_STEEP = 0.8  # tangent; what is steeper is a step, and no ramp
_NARROW = 5  # samples of which the middle one in height counts
_EDGE = 0.1  # m; a lower edge makes no gap
_WIDEST_GAP = 1.5  # m; what is longer is a floor of its own
_NO_GROUND = 2.0  # m below the course, where there is none
_EVERY = 10  # samples from one look at the walls to the next


@dataclass(frozen=True, kw_only=True)
class Demands:
    """What a course asks for. Metres.

    Attributes:
        up, down: of the highest steps.
        gap: length of the longest gap from rim to rim.
        depth: of the deepest gap under its lower rim.
        room: between walls where they are nearest, at the height of the trunk; inf = no walls.
    """

    up: float
    down: float
    gap: float
    depth: float
    room: float


def demands_of(scene: Scene, height: float) -> Demands:
    """Measure a scene along its course.

    Args:
        scene: whose course.
        height: over the course at which its walls are looked for, m.
    """
    samples = course_samples(scene, _SPACING, most=5_000)
    left = np.column_stack([samples.left, np.zeros(len(samples.along))])
    lines = samples.points[:, None] + np.array(_SIDES)[:, None] * left[:, None]
    above = np.repeat(samples.above, len(_SIDES))
    origins = np.column_stack([lines.reshape(-1, 3)[:, :2], above])
    middle = samples.points[::_EVERY] + np.array([0.0, 0.0, height])
    aside = left[::_EVERY]
    down = np.tile([0.0, 0.0, -1.0], (len(origins), 1))
    met = solid_distances(
        scene,
        np.concatenate([origins, middle, middle]),
        np.concatenate([down, aside, -aside]),
    )
    ground = (above - met[: len(origins)]).reshape(lines.shape[:2])
    profile = np.median(np.maximum(ground, samples.points[:, 2:] - _NO_GROUND), axis=1)
    # What is narrower than a foot is neither step nor gap, such as a slit between two treads.
    windows = sliding_window_view(np.pad(profile, _NARROW // 2, mode="edge"), _NARROW)
    profile = np.median(windows, axis=1)
    to_left, to_right = np.split(met[len(origins) :], 2)
    edges = _edges(profile)
    gaps = _gaps(edges, samples.along, profile) if scene.task == "gaps" else []
    in_gaps = {edge for gap in gaps for edge in (gap[0], gap[1])}
    steps = [rise for first, _, rise in edges if first not in in_gaps]
    return Demands(
        up=max([0.0, *steps]),
        down=max([0.0, *(-rise for rise in steps)]),
        gap=max((length for _, _, length, _ in gaps), default=0.0),
        depth=max((depth for _, _, _, depth in gaps), default=0.0),
        room=float((to_left + to_right).min()),
    )


def _edges(profile: Values) -> list[tuple[int, int, float]]:
    """Return first and last sample and rise, m, of every steep stretch that goes one way."""
    rises = np.diff(profile)
    steep = np.abs(rises) > _STEEP * _SPACING
    edges: list[tuple[int, int, float]] = []
    for index in np.flatnonzero(steep).tolist():
        rise = float(rises[index])
        if edges and edges[-1][1] == index and edges[-1][2] * rise > 0.0:
            first, _, before = edges.pop()
            edges.append((first, index + 1, before + rise))
        else:
            edges.append((index, index + 1, rise))
    return edges


def _gaps(
    edges: list[tuple[int, int, float]], along: Values, profile: Values
) -> list[tuple[int, int, float, float]]:
    """Return both edges, length and depth, m, of every gap: down, and up again."""
    gaps: list[tuple[int, int, float, float]] = []
    high = [edge for edge in edges if abs(edge[2]) > _EDGE]
    for (first, bottom, drop), (start, top, rise) in pairwise(high):
        length = float(along[top] - along[first])
        if drop < 0.0 < rise and length <= _WIDEST_GAP:
            lower = min(profile[first], profile[top])
            gaps.append((first, start, length, float(lower - profile[bottom : start + 1].min())))
    return gaps


@dataclass(frozen=True, kw_only=True)
class Legs:
    """What a robot has to meet it with. Metres.

    Attributes:
        robot: its name.
        length: of the longest leg, from its first joint to the sole.
        width: over the feet.
        height: of the trunk over the ground.
    """

    robot: str
    length: float
    width: float
    height: float


def legs_of(robot: RobotSpec) -> Legs:
    """Measure a robot's legs; its joints turn within their ranges."""
    stance = stance_of(robot)
    with flat_world(robot) as world:
        length = float(world.reaches().max())
    return Legs(
        robot=robot.name, length=length, width=2.0 * stance.half_width, height=stance.height
    )


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A scene's demands against a robot's legs."""

    legs: Legs
    demands: Demands

    @property
    def beyond(self) -> tuple[str, ...]:
        """What the scene asks that the robot cannot do, in words; empty if nothing."""
        asked, leg = self.demands, self.legs.length
        steps = [
            f"a step of {size:.2f} m {way}"
            for way, size in (("up", asked.up), ("down", asked.down))
            if size > LONGEST_STEP * leg
        ]
        if asked.gap > LONGEST_GAP * leg and asked.depth > LONGEST_STEP * leg:
            steps.append(f"a gap of {asked.gap:.2f} m")
        if asked.room < self.legs.width:
            steps.append(f"{asked.room:.2f} m between walls for a width of {self.legs.width:.2f} m")
        return tuple(steps)

    @property
    def asks_for(self) -> str:
        """`walking`, `climbing`, `leaping`, or `more than it could do`."""
        if self.beyond:
            return "more than it could do"
        asked, walked = self.demands, WALKED * self.legs.length
        if asked.gap > walked:
            return "leaping"
        return "climbing" if max(asked.up, asked.down) > walked else "walking"

    def __str__(self) -> str:
        asked, leg = self.demands, self.legs.length
        share = max(asked.up, asked.down) / leg
        steps = f"steps of {asked.up:.2f} m up and {asked.down:.2f} m down at most"
        parts = [f"{steps} are {share:.2f} of a leg of {leg:.2f} m"]
        if asked.gap:
            parts.append(f"gaps of {asked.gap:.2f} m at most are {asked.gap / leg:.2f} of it")
        if np.isfinite(asked.room):
            parts.append(f"walls are {asked.room:.1f} m apart, it is {self.legs.width:.2f} m wide")
        return f"for the legs of {self.legs.robot}: {', '.join(parts)}: {self.asks_for}"


def fit_of(scene: Scene, legs: Legs) -> Fit:
    """Return how a scene's steps, gaps and walls compare with a robot's legs and width."""
    return Fit(legs=legs, demands=demands_of(scene, legs.height))


def beyond_finding(fit: Fit) -> SceneFinding | None:
    """Return that a scene asks for more than a robot's legs could do; None if it does not."""
    if not fit.beyond:
        return None
    return SceneFinding(
        code="beyond_legs",
        severity="warning",
        message=f"it asks for {' and '.join(fit.beyond)}, more than a {fit.legs.robot} could do: "
        f"its legs are {fit.legs.length:.2f} m long",
        fix="choose another scene or another robot",
        value=max(fit.demands.up, fit.demands.down, fit.demands.gap),
    )
