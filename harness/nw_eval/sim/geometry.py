"""Puts a scene's collision geometry into a MuJoCo specification.

A scene offers `ground` (a plane) and `solids`: boxes here; height fields, triangles and
round primitives by `nw_eval.scenes.attach`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from nw_eval.scenes.attach import add_height_field, add_primitive, add_triangles
from nw_eval.scenes.scene import Box, HeightField, Primitive, Triangles
from nw_eval.sim.binding import MjBody, MjSpec, mujoco

if TYPE_CHECKING:
    from nw_eval.scenes.scene import Scene

# With an override, scene geometry outranks the robot's, so that its friction alone counts.
_OVERRIDING_PRIORITY = 1


def add_geometry(spec: MjSpec, scene: Scene, *, friction: float | None) -> None:
    """Add ground and solids to the world body.

    Between two geoms MuJoCo takes the larger friction, element by element, so a foot (1.0) on the
    published ground (1.25) slides at 1.25. `friction` replaces the tangential coefficient of all
    scene geometry and then holds for every contact with it, also below the foot's own 1.0.
    """
    priority = 0 if friction is None else _OVERRIDING_PRIORITY
    world = spec.worldbody
    world.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        pos=[0, 0, scene.ground.z],
        friction=_with_tangential(scene.ground.friction, friction),
        priority=priority,
    )
    for index, solid in enumerate(scene.solids):
        name = f"solid_{index}"
        rough = _with_tangential(solid.friction, friction)
        match solid:
            case HeightField():
                add_height_field(spec, name, solid, friction=rough, priority=priority)
            case Triangles():
                add_triangles(spec, name, solid, friction=rough, priority=priority)
            case Primitive():
                add_primitive(spec, name, solid, friction=rough, priority=priority)
            case Box():
                _add_box(world, name, solid, friction=friction, priority=priority)
            case _:
                assert_never(solid)


def _add_box(world: MjBody, name: str, box: Box, *, friction: float | None, priority: int) -> None:
    world.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=list(box.half_size),
        pos=list(box.center),
        quat=list(box.quat),
        friction=_with_tangential(box.friction, friction),
        priority=priority,
    )


def _with_tangential(friction: tuple[float, float, float], tangential: float | None) -> list[float]:
    return [friction[0] if tangential is None else tangential, friction[1], friction[2]]
