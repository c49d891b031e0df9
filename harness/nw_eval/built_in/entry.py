"""One entry of the catalogue, and how it becomes a scene."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from nw_eval.built_in.lights import LIGHTS
from nw_eval.built_in.places.crowns import crown_mesh
from nw_eval.built_in.places.parts import Place
from nw_eval.built_in.places.stage import Stage
from nw_eval.built_in.splat import BuiltInSplat
from nw_eval.scenes.mesh import TriangleMesh, merge, quad_mesh
from nw_eval.scenes.scene import Box, Plane, Scene, Spawn, Vector
from nw_eval.words import Task

# The robot's eye, metres above what it stands on.
EYE_HEIGHT = 0.3
# The ground that rays meet reaches this far from the spawn, metres.
_GROUND_REACH = 60.0


class Course(Protocol):
    """The obstacles of one scene and the trail over them.

    The trail is told in the world, where the spawn stands at z = 0; obstacles are built on a stage
    whose ground is at z = 0.
    """

    @property
    def floor(self) -> float:
        """Height of the ground in the world, metres; below 0 where the spawn stands higher."""
        ...

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
        exposure: multiplies that light's own, where the camera's automatic would choose badly.
        task: what the trail asks of a robot.
        waypoint_noise: half widths in metres along x and y.
        spawn: where the robot starts.
    """

    name: str
    title: str
    setting: Setting
    course: Course
    light: str
    exposure: float = 1.0
    task: Task = "hurdles"
    waypoint_noise: tuple[float, float] = (0.0, 0.1)
    spawn: Spawn = field(default_factory=Spawn)

    def place(self) -> Place:
        """Return the parts of the place, course included; its ground is at z = 0."""
        trail = self._trail()
        up = EYE_HEIGHT - self.course.floor
        eyes = [(0.0, 0.0, up), *((x, y, z + up) for x, y, z in trail)]
        light = LIGHTS[self.light]
        light = replace(light, exposure=light.exposure * self.exposure)
        stage = Stage(self.name, light, indoor=self.setting.indoor, eyes=eyes)
        self.setting.build(stage, trail[-1][0])
        self.course.build(stage)
        return stage.place()

    def _trail(self) -> tuple[Vector, ...]:
        """Return the waypoints to a nanometre, whatever the C library makes of sines."""
        return tuple((round(x, 9), round(y, 9), round(z, 9)) for x, y, z in self.course.trail())

    def scene(self) -> Scene:
        """Return the scene; its splat is not made yet."""
        place = self.place()
        floor = self.course.floor
        mesh = place_mesh(place)
        T_world_place = np.eye(4)
        T_world_place[2, 3] = floor
        return Scene(
            name=self.name,
            task=self.task,
            title=self.title,
            solids=tuple(_moved(solid, floor) for solid in place.solids),
            ground=Plane(z=floor),
            trail=np.array(self._trail(), dtype=np.float64),
            static_mesh=replace(mesh, vertices=np.round(mesh.vertices + T_world_place[:3, 3], 9)),
            T_world_splat=T_world_place,
            splat=BuiltInSplat(place=place),
            spawn=self.spawn,
            waypoint_noise=self.waypoint_noise,
        )


def _moved(solid: Box, up: float) -> Box:
    x, y, z = solid.center
    return replace(solid, center=(x, y, round(z + up, 9)))


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
