"""Things of a scene that move: a door on a hinge, a crate that a robot pushes.

A prop is a body: boxes collide, a mesh or a splat is seen. Both are in the prop's own frame, which
the pose moves. A prop that is drawn by a splat is met by rays as its boxes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nw_scenes.mesh import FaceKind, TriangleMesh, box_mesh, merge

Vector = tuple[float, float, float]
Quat = tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class PropBox:
    """A solid box of a prop, in the prop's frame: metres, quaternion w x y z."""

    center: Vector = (0.0, 0.0, 0.0)
    half_size: Vector
    quat: Quat = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class PropJoint:
    """How a prop moves; frames are the prop's own where it stands at the start.

    Attributes:
        type: `fixed` to the world, `free`, turning about an axis (`hinge`), or along it (`slide`).
        axis: of a hinge or a slide.
        anchor: a point on the axis of a hinge, m.
        range: least and largest angle, rad, or way, m; None = no limit.
        damping: N m s/rad, or N s/m; of a free prop none.
        friction: what the joint holds at rest, N m or N.
    """

    type: Literal["fixed", "free", "hinge", "slide"] = "free"
    axis: Vector = (0.0, 0.0, 1.0)
    anchor: Vector = (0.0, 0.0, 0.0)
    range: tuple[float, float] | None = None
    damping: float = 0.0
    friction: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Prop:
    """A body of a scene beside the robot.

    Attributes:
        name: a word, unique in the scene.
        position: of its frame in the world at the start, m.
        quat: as above, w x y z.
        boxes: what collides, at least one.
        mass: kg; it is spread over the boxes by their volume.
        friction: MuJoCo's sliding, torsional and rolling coefficients.
        joint: how it moves.
        kind: its class in `semantics` images.
        mesh: what it looks like, in its frame, m; None = its splat.
        color: of the mesh, 0 to 1, as displayed (sRGB).
        splat: the source of its Gaussians; None = its mesh.
        T_prop_splat: (4, 4) similarity that maps splat points to metres in its frame.
    """

    name: str
    position: Vector
    quat: Quat = (1.0, 0.0, 0.0, 0.0)
    boxes: tuple[PropBox, ...]
    mass: float = 1.0
    friction: Vector = (1.0, 0.005, 0.0001)
    joint: PropJoint = PropJoint()
    kind: FaceKind = "obstacle"
    mesh: TriangleMesh | None = None
    color: Vector = (0.5, 0.5, 0.5)
    splat: Any = None  # A `scene.SplatSource`.
    T_prop_splat: NDArray[np.float64]

    @cached_property
    def solid(self) -> TriangleMesh:
        """What rays meet, in the prop's frame: its mesh, or its boxes."""
        if self.mesh is not None:
            return self.mesh
        return merge([box_mesh(b.center, b.half_size, b.quat, self.kind) for b in self.boxes])

    @property
    def facts(self) -> tuple[Any, ...]:
        """What of it can change a result, for the scene's digest."""
        mesh = None if self.mesh is None else (self.mesh.vertices, self.mesh.faces)
        splat = None if self.splat is None else (self.splat.key, self.T_prop_splat)
        shape = (self.boxes, self.mass, self.friction, self.joint)
        return (self.name, self.position, self.quat, *shape, self.kind, mesh, self.color, splat)


def prop_body(name: str) -> str:
    """Return what the body, the joint and the frame of a prop are called."""
    return f"prop/{name}"


def box_round(mesh: TriangleMesh) -> PropBox:
    """Return the box round a mesh, along the axes of its frame; at least a millimetre thick."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    x, y, z = ((low + high) / 2).tolist()
    a, b, c = np.maximum((high - low) / 2, 5e-4).tolist()
    return PropBox(center=(x, y, z), half_size=(a, b, c))
