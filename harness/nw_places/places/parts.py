"""The pieces that a scene is made of, as plain data."""

from __future__ import annotations

from dataclasses import dataclass

from nw_scenes.mesh import FaceKind
from nw_scenes.scene import Box, Vector

Pair = tuple[float, float]


@dataclass(frozen=True)
class Decal:
    """Another material within a rectangle of a patch: a window in a wall, a line on a road.

    Attributes:
        rect: u0, v0, u1, v1 in metres on the patch.
        material: name in the paint registry, with an optional colour: `poster/teal`.
        fine: multiplies the spacing of Gaussians within the rectangle.
        opening: the sun shines in through it, but for its frame.
    """

    rect: tuple[float, float, float, float]
    material: str
    fine: float = 0.6
    opening: bool = False


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A parallelogram with a material; its outside is the side that `u` x `v` points to.

    Attributes:
        origin, u, v: corner and edges, metres, world.
        material: name in the paint registry, with an optional colour: `carpet/blue`.
        kind: what rays take it for; None keeps it out of the mesh (paint on the ground quad).
        painted: whether Gaussians lie on it; hidden faces are not painted.
        fine: multiplies the spacing of Gaussians.
        texture: texture coordinates of `origin` in metres, so that patterns run round corners.
        decals: drawn over the material, later ones on top.
    """

    origin: Vector
    u: Vector
    v: Vector
    material: str
    kind: FaceKind | None = "structure"
    painted: bool = True
    fine: float = 1.0
    texture: Pair = (0.0, 0.0)
    decals: tuple[Decal, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Crown:
    """A cloud of leaves in an ellipsoid: the crown of a tree, a bush, a stretch of hedge."""

    center: Vector
    radii: Vector
    material: str
    kind: FaceKind = "overhead"
    fine: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Lawn:
    """Blades of grass standing on the ground within a rectangle x0, y0, x1, y1, metres."""

    rect: tuple[float, float, float, float]
    material: str
    height: float = 0.045


@dataclass(frozen=True, kw_only=True)
class Lamp:
    """A glowing parallelogram: radiance in units where white paper in the sun is about 1."""

    origin: Vector
    u: Vector
    v: Vector
    radiance: Vector


@dataclass(frozen=True, kw_only=True)
class Light:
    """What shines on a scene from outside it.

    Attributes:
        sun: direction to the sun; any length.
        sun_colour: what a white surface that faces the sun sends back.
        zenith, horizon: radiance of the sky.
        clouds: 0 clear to 1 covered.
        exposure: multiplies everything before the tone curve.
        fog: share of the horizon's colour that a thing 30 m away takes on.
    """

    sun: Vector
    sun_colour: Vector
    zenith: Vector
    horizon: Vector
    clouds: float = 0.3
    exposure: float = 1.0
    fog: float = 0.08


@dataclass(frozen=True, kw_only=True)
class Place:
    """Everything that a scene is built from. The splat depends on nothing else."""

    name: str
    indoor: bool
    light: Light
    ground: str
    solids: tuple[Box, ...]
    patches: tuple[Patch, ...]
    crowns: tuple[Crown, ...]
    lawns: tuple[Lawn, ...]
    lamps: tuple[Lamp, ...]
    eyes: tuple[Vector, ...]
