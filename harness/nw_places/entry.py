"""One built-in scene: what there is to say about it, and how it becomes a scene.

Its splat is made once into the user's cache. `LIGHTS` are the skies and suns that a scene can name.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np

from nw_base.errors import SceneError
from nw_base.files.cache import cache_dir
from nw_base.words import Task
from nw_places.places.builder import SceneBuilder
from nw_places.places.crowns import crown_mesh
from nw_places.places.parts import Light, Place
from nw_scenes.digest import digest
from nw_scenes.mesh import TriangleMesh, merge, quad_mesh
from nw_scenes.scene import Box, Plane, Scene, Spawn, Vector

if TYPE_CHECKING:
    from nw_scenes.scene import Progress


# The robot's eye, metres above what it stands on.
EYE_HEIGHT = 0.3
# The ground that rays meet reaches this far from the spawn, metres.
_GROUND_REACH = 60.0

# Raise it with every change that changes a Gaussian of any scene.
GENERATOR_VERSION = 5

LIGHTS: dict[str, Light] = {
    "noon": Light(
        sun=(-0.35, 0.45, 0.85),
        sun_colour=(1.55, 1.48, 1.34),
        zenith=(0.17, 0.31, 0.62),
        horizon=(0.55, 0.66, 0.80),
        clouds=0.30,
        exposure=1.0,
    ),
    "afternoon": Light(
        sun=(-0.55, -0.62, 0.58),
        sun_colour=(1.60, 1.38, 1.06),
        zenith=(0.18, 0.30, 0.58),
        horizon=(0.66, 0.68, 0.72),
        clouds=0.42,
        exposure=1.05,
    ),
    "morning": Light(
        sun=(0.30, 0.75, 0.52),
        sun_colour=(1.50, 1.30, 1.02),
        zenith=(0.20, 0.33, 0.62),
        horizon=(0.70, 0.74, 0.80),
        clouds=0.25,
        exposure=0.75,
    ),
    "forenoon": Light(
        sun=(-0.72, 0.17, 0.62),
        sun_colour=(1.58, 1.45, 1.22),
        zenith=(0.17, 0.31, 0.62),
        horizon=(0.58, 0.67, 0.79),
        clouds=0.35,
        exposure=0.78,
    ),
    "overcast": Light(
        sun=(-0.2, 0.3, 0.93),
        sun_colour=(0.12, 0.12, 0.12),
        zenith=(0.82, 0.86, 0.92),
        horizon=(0.62, 0.65, 0.70),
        clouds=1.0,
        exposure=0.8,
        fog=0.10,
    ),
    "dusk": Light(
        sun=(0.80, -0.55, 0.17),
        sun_colour=(0.55, 0.24, 0.10),
        zenith=(0.12, 0.19, 0.44),
        horizon=(0.60, 0.38, 0.32),
        clouds=0.50,
        exposure=0.62,
        fog=0.12,
    ),
    # The sun is the moon; lamps in the scene do the rest.
    "night": Light(
        sun=(-0.4, -0.5, 0.75),
        sun_colour=(0.012, 0.015, 0.022),
        zenith=(0.003, 0.005, 0.012),
        horizon=(0.012, 0.011, 0.013),
        clouds=0.10,
        exposure=0.30,
        fog=0.0,
    ),
    # Indoors: the sky and sun are what windows show and let in.
    "indoor": Light(
        sun=(-0.25, 0.85, 0.62),
        sun_colour=(1.9, 1.75, 1.5),
        zenith=(1.3, 1.6, 2.1),
        horizon=(2.0, 2.1, 2.2),
        clouds=0.3,
        exposure=1.0,
        fog=0.0,
    ),
    "indoor_evening": Light(
        sun=(0.30, -0.90, 0.30),
        sun_colour=(1.9, 1.15, 0.6),
        zenith=(0.25, 0.3, 0.5),
        horizon=(0.8, 0.6, 0.5),
        clouds=0.3,
        exposure=1.05,
        fog=0.0,
    ),
    "indoor_night": Light(
        sun=(-0.4, -0.5, 0.75),
        sun_colour=(0.02, 0.02, 0.03),
        zenith=(0.02, 0.03, 0.06),
        horizon=(0.07, 0.06, 0.07),
        clouds=0.15,
        exposure=0.92,
        fog=0.0,
    ),
}


class Course(Protocol):
    """The obstacles of one scene and the waypoints over them.

    Waypoints are in the world, where the spawn stands at z = 0; obstacles are built on a stage
    whose ground is at z = 0.
    """

    @property
    def floor(self) -> float:
        """Height of the ground in the world, metres; below 0 where the spawn stands higher."""
        ...

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints, metres."""
        ...

    def build(self, builder: SceneBuilder) -> None:
        """Build the obstacles."""
        ...


class Setting(Protocol):
    """The kind of place that a course lies in."""

    @property
    def indoor(self) -> bool:
        """Whether a roof keeps sky and sun out."""
        ...

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the scene, around a course of `length` metres along x."""
        ...


@dataclass(frozen=True, kw_only=True)
class Entry:
    """All there is to say about a built-in scene.

    Attributes:
        name: such as `hurdles/one_low_carpet`.
        title: one line for people.
        setting: the scene round the course.
        course: obstacles and trail.
        light: a name of `LIGHTS`.
        exposure: multiplies that light's own, where the camera's automatic would choose badly.
        waypoint_noise: half widths in metres along x and y.
        spawn: where the robot starts.
    """

    name: str
    title: str
    setting: Setting
    course: Course
    light: str
    exposure: float = 1.0
    waypoint_noise: tuple[float, float] = (0.0, 0.1)
    spawn: Spawn = field(default_factory=Spawn)

    @property
    def task(self) -> Task:
        """What the course asks of a robot, as the name says; an empty place is for `hurdles`."""
        kind = self.name.partition("/")[0]
        return "hurdles" if kind == "flat" else cast("Task", kind)

    def place(self) -> Place:
        """Return the parts of the scene, course included; its ground is at z = 0."""
        trail = self._trail()
        up = EYE_HEIGHT - self.course.floor
        eyes = [(0.0, 0.0, up), *((x, y, z + up) for x, y, z in trail)]
        light = LIGHTS[self.light]
        light = replace(light, exposure=light.exposure * self.exposure)
        builder = SceneBuilder(self.name, light, indoor=self.setting.indoor, eyes=eyes)
        self.setting.build(builder, trail[-1][0])
        self.course.build(builder)
        return builder.place()

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


@dataclass(frozen=True, kw_only=True)
class BuiltInSplat:
    """Gaussians generated from a scene's textured geometry."""

    place: Place

    @property
    def key(self) -> str:
        """Hex digest of the scene and of the generator's version."""
        return self._key

    @cached_property
    def _key(self) -> str:
        return digest(GENERATOR_VERSION, self.place)

    @property
    def path(self) -> Path:
        """Where the compiled store lies in the cache, or is to lie."""
        from nw_splat.store import FORMAT, SUFFIX

        # Versions of nw-eval that share a cache do not undo each other's.
        name = f"{self.place.name.replace('/', '-')}-{self.key[:16]}-{FORMAT}"
        return cache_dir("scenes") / f"{name}{SUFFIX}"

    def store(self, progress: Progress | None = None) -> Path:
        """Return the compiled store; build it in the cache on first use."""
        from nw_splat.store import compile_store, open_store

        path = self.path
        if path.is_file():
            try:
                open_store(path, key=self.key)
            except SceneError:
                pass  # Damaged: made anew below.
            else:
                return path
        from nw_places.bake.generate import generate

        compile_store(generate(self.place, progress), path, key=self.key)
        if progress is not None:
            progress("stored", 1.0)
        return path
