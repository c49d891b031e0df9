"""One entry of the catalogue, and how it becomes a scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from nw_eval.scenes.lights import LIGHTS
from nw_eval.scenes.mesh import TriangleMesh, merge, quad_mesh
from nw_eval.scenes.places.crowns import crown_mesh
from nw_eval.scenes.places.parts import Place
from nw_eval.scenes.places.stage import Stage
from nw_eval.scenes.scene import Scene, Spawn, Task, Vector
from nw_eval.scenes.twin import BuiltInSplat

# The robot's eye, metres above what it stands on.
EYE_HEIGHT = 0.3
# The ground that rays meet reaches this far from the spawn, metres.
_GROUND_REACH = 60.0


class Course(Protocol):
    """The obstacles of one scene and the trail over them."""

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints, metres."""
        ...

    def build(self, stage: Stage) -> None:
        """Put the obstacles on the stage."""
        ...


class Setting(Protocol):
    """The kind of place that a course lies in."""

    @property
    def indoor(self) -> bool:
        """Whether a roof keeps sky and sun out."""
        ...

    def build(self, stage: Stage, length: float) -> None:
        """Put the place on the stage, round a trail of `length` metres along x."""
        ...


@dataclass(frozen=True, kw_only=True)
class Entry:
    """All there is to say about a built-in scene.

    Attributes:
        name: such as `hurdles/one_low_carpet`.
        title: one line for people.
        setting: the place round the course.
        course: obstacles and trail.
        light: a name of `LIGHTS`.
        task: what the trail asks of a robot.
        waypoint_noise: half widths in metres along x and y.
        spawn: where the robot starts.
    """

    name: str
    title: str
    setting: Setting
    course: Course
    light: str
    task: Task = "hurdles"
    waypoint_noise: tuple[float, float] = (0.0, 0.1)
    spawn: Spawn = field(default_factory=Spawn)

    def place(self) -> Place:
        """Return the parts of the place, course included."""
        trail = self.course.trail()
        eyes = [(0.0, 0.0, EYE_HEIGHT), *((x, y, z + EYE_HEIGHT) for x, y, z in trail)]
        stage = Stage(self.name, LIGHTS[self.light], indoor=self.setting.indoor, eyes=eyes)
        self.setting.build(stage, trail[-1][0])
        self.course.build(stage)
        return stage.place()

    def scene(self) -> Scene:
        """Return the scene; its splat is not made yet."""
        place = self.place()
        return Scene(
            name=self.name,
            task=self.task,
            title=self.title,
            solids=place.solids,
            trail=np.array(self.course.trail(), dtype=np.float64),
            static_mesh=place_mesh(place),
            splat=BuiltInSplat(place=place),
            spawn=self.spawn,
            waypoint_noise=self.waypoint_noise,
        )


def place_mesh(place: Place) -> TriangleMesh:
    """Return what rays meet: the ground first, then patches and crowns in order."""
    reach = _GROUND_REACH
    parts = [quad_mesh((-reach, -reach, 0), (2 * reach, 0, 0), (0, 2 * reach, 0), "ground")]
    parts += [
        quad_mesh(patch.origin, patch.u, patch.v, patch.kind)
        for patch in place.patches
        if patch.kind is not None
    ]
    parts += [crown_mesh(crown) for crown in place.crowns]
    return merge(parts)
